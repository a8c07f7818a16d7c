"""What all of the analyzer shares: parameters, metrics, columns, names."""

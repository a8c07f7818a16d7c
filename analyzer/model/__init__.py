"""Words that every part of the analyzer shares: parameters, metrics, columns, names of groups."""

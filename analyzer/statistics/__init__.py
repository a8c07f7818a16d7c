"""Statistics of samples, in pure numpy."""

"""The whole parameter space from one plan."""

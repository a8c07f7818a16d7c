"""Comparisons of two sides, limits and their outcomes for CI."""

"""Percentiles, histograms, intervals and sample sizes; pure numpy."""

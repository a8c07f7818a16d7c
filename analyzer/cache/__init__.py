"""Reuse between analyses: traces, events, rows and frames in the cache folder of the user."""

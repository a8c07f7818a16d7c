"""Recordings that are not ours: rate, gaps, jitter, size and age of every topic."""

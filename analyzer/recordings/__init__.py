"""Foreign recordings: rate, gaps, jitter, size and age of every topic."""

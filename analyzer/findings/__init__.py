"""Findings: `table` lists them, `evidence` is what they look at."""

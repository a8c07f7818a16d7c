"""Findings: `table` lists the checks, `evidence` has their record and what they look at."""

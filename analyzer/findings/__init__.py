"""Findings: `table` lists the checks, `check` is their record, `evidence` what they look at."""

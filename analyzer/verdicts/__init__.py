"""Verdicts on groups: which setup is fastest or meets a deadline, and what changed between two sides."""

"""Contents of a report, computed once from an `Analysis`: groups, numbers, answer, overview, findings."""

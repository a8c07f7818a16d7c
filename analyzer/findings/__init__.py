"""Findings: what is doubtful in an analysis, and what to do about it.

`table` has a row per check; `evidence` is what the checks look at; every other file has the checks of one subject.
"""

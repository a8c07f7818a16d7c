"""Findings: what is doubtful in an analysis, and what to do about it.

`table` lists the checks, `check` is their record, `evidence` what they look at; every other file has the checks of one subject.
"""

"""Figures of a report, one file each or a row of lines; `table` has their order."""

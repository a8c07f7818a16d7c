"""A saved analysis: a folder of checked files that is replaced as a whole (`docs/how-to/analyze.md`)."""

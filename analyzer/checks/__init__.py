"""The checks behind the findings, by what they look at; `analyzer.findings` holds the table of all."""

"""The checks behind the findings, by what they look at; `dds_trace.analyzer.findings` holds the table of all."""

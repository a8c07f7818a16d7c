"""`python -m dds_trace.cli.record`."""

from dds_trace.cli.record.command import main

main()

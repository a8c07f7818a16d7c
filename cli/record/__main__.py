"""`python -m dds_trace.cli.record`."""

from dds_trace.cli.dds_record import main

main()

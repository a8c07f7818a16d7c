"""`python -m dds_trace.cli.record`."""

from .command import main

main()

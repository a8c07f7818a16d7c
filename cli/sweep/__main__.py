"""`python -m dds_trace.cli.sweep`."""

from .command import main

main()

"""`python -m dds_trace`: `dds-trace`."""

import sys

from dds_trace.cli.trace import PROGRAM, main

sys.argv[0] = PROGRAM
main()

"""The one place that turns a `TraceError` into a line on stderr and an exit code."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


def run_command(command: Callable[[], object]) -> None:
    """Call a command's app; end the process with one clear message at an error that a user can act on.

    Args:
        command: reads its arguments from the command line, as a `typer.Typer` does when called.
    """
    try:
        command()
    except Exception as error:
        from dds_trace.tracefile import TraceError  # not loaded before, so that --help is quick

        if not isinstance(error, TraceError):
            raise
        print(f"{Path(sys.argv[0]).name}: {error}", file=sys.stderr)
        sys.exit(error.exit_code)

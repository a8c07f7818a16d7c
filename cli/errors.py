"""Turns a `TraceError`, or a missing package, into a line on stderr and an exit code."""

from __future__ import annotations

import re
import sys
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

_EXTRA = re.compile(r"""(?P<package>[\w-]+).*\bextra == ['"](?P<extra>\w+)['"]""")
"""A requirement of an extra, such as `polars<3,>=1.30; extra == 'analyze'`."""


_TOO_LARGE = "not enough memory; request smaller or fewer messages, or give a part of the traces"


def run_command(command: Callable[[], object]) -> None:
    """Call a command's app; end the process with one line at an error that a user can act on."""
    # Escape what the terminal's encoding lacks.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        command()
    except MemoryError:
        print(f"{Path(sys.argv[0]).name}: {_TOO_LARGE}", file=sys.stderr)
        sys.exit(1)
    except ModuleNotFoundError as error:
        extra = _extra_with(error.name or "")
        if extra is None:
            raise
        from dds_trace.base.errors import BackendUnavailableError

        what = f"needs {error.name}, which is not installed: pip install 'dds-trace[{extra}]'"
        print(f"{Path(sys.argv[0]).name} {what}", file=sys.stderr)
        sys.exit(BackendUnavailableError.exit_code)
    except Exception as error:
        from dds_trace.base.errors import TraceError

        if not isinstance(error, TraceError):
            raise
        print(f"{Path(sys.argv[0]).name}: {error}", file=sys.stderr)
        sys.exit(error.exit_code)


def _extra_with(module: str) -> str | None:
    """Return the extra that brings the package of a module, None if none does."""
    from importlib.metadata import requires  # slow, and rarely needed

    package = module.partition(".")[0]
    for requirement in requires("dds-trace") or ():
        named = _EXTRA.match(requirement)
        if named is not None and named["package"].lower() == package:
            return named["extra"]
    return None

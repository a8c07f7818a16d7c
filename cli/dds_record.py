"""`dds-record --role ROLE`: `dds-trace record ROLE` by its first name."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from dds_trace.base.shortage import RECORDING

from .program import run_command
from .record.command import app
from .table_options import settings_as_options
from .trace import main as dds_trace
from .trace import run_alias


def main(arguments: Sequence[str] | None = None) -> None:
    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[:1] == ["status"]:
        dds_trace(["record", *words])
    run_command(
        lambda: run_alias("dds-record", app, ["record", *settings_as_options(words)]),
        needs_stdout=False,
        room=RECORDING,
    )


if __name__ == "__main__":
    main()

"""`dds-trace recover FILE`: what a killed recorder left, or a damaged bag, as a whole copy."""

from __future__ import annotations

from pathlib import Path
from textwrap import fill
from typing import Annotated

from dds_trace.base import limits
from dds_trace.cli.program import argument, command, make_app, option

app = make_app()


@command(app, "recover")
def recover_command(
    path: Annotated[Path, argument("FILE", "A .mcap file, its ring, or a bag of another program.")],
    out: Annotated[Path | None, option("--out PATH", "File or folder to write. Default: next to FILE")] = None,
) -> None:
    """Recover a trace after a crash, or a damaged bag."""
    from .recover import is_of_others, recover_recording
    from .recover_trace import recover

    limits.check(limits.INPUT, str(path), "FILE")
    limits.check(limits.PATH, None if out is None else str(out), "--out")
    report = (recover_recording if is_of_others(path) else recover)(path, out)
    if report.recovered is not None:
        print(f"Wrote {report.recovered}")
    for line in report.lines():
        print(fill(line, 80, break_long_words=False, break_on_hyphens=False))

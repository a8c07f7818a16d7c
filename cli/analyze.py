"""`dds-analyze runs/`: a folder of traces becomes tables, reports and Parquet files.

    dds-analyze FOLDER [--report html|md|json|terminal]... [--out FOLDER]

Further commands (`dds-analyze compare BASE NEW`) are entries of `COMMANDS`: the first argument chooses one, and
anything else is the folder of the command without a name, so that no command ever changes what `dds-analyze
runs/` means. A folder that bears the name of a command is written `./compare`.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from tracefile import TraceError


class ReportKind(str, Enum):
    """What `--report` takes; one for each of `reports.REPORTERS`."""

    HTML = "html"
    MD = "md"
    JSON = "json"
    TERMINAL = "terminal"


app = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)


@app.command(name="dds-analyze")
def analyze_folder(
    folder: Annotated[
        Path,
        typer.Argument(
            help="Folder with traces (.mcap files, rosbag2 folders; looked through to its depths), or one trace.",
            show_default=False,
        ),
    ],
    report: Annotated[
        list[ReportKind] | None,
        typer.Option(
            help="Kind of report; may be given several times. [default: terminal]", show_default=False
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for all files written. [default: analysis/ in FOLDER]", show_default=False),
    ] = None,
) -> None:
    """Analyze a folder of traces: latency, losses and rates per middleware, domain, size and frequency.

    Writes roundtrips.parquet and summary.parquet (replacing those of an earlier analysis) and the reports
    asked for. Results go to stdout, progress and warnings to stderr.
    """
    from analyzer import analyze, default_output
    from reports import write_report

    target = default_output(folder) if out is None else out
    with _progress() as progress:
        analysis = analyze(folder, out=target, progress=progress)
    written = list(analysis.outputs.values())
    for kind in report or [ReportKind.TERMINAL]:
        path = write_report(analysis, kind.value, target)
        if path is not None:
            written.append(path)
    for path in written:
        print(f"Wrote {path}")
    doubts = [finding for finding in analysis.findings if finding.severity.value == "error"]
    for finding in doubts:
        print(f"{finding.where}: {finding.what} {finding.action}", file=sys.stderr)


COMMANDS: dict[str, typer.Typer] = {}
"""Name -> command, beside the one without a name."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run `dds-analyze` and exit with its code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    named = COMMANDS.get(given[0]) if given else None
    command, rest = (app, given) if named is None else (named, given[1:])
    try:
        command(rest, prog_name="dds-analyze" if named is None else f"dds-analyze {given[0]}")
    except TraceError as err:
        print(f"dds-analyze: {err}", file=sys.stderr)
        sys.exit(err.exit_code)


@contextmanager
def _progress() -> Iterator[Callable[[int, int, Path], None] | None]:
    """A bar on stderr that tells which trace is read; nothing where stderr is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("reading", total=None)

        def show(done: int, total: int, path: Path) -> None:
            bar.update(task, completed=done, total=total, description=path.name)

        yield show

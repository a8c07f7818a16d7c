"""`dds-analyze runs/`: a folder of traces becomes tables, reports and Parquet files.

Further commands, such as `dds-analyze compare BASE NEW`, are entries of `COMMANDS`: the first argument chooses
one, and anything else belongs to the command without a name. So no command changes what `dds-analyze runs/`
means; a folder that bears the name of a command is written `./compare`.
"""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from cli.errors import run_command


class ReportKind(str, Enum):
    """What `--report` takes; the keys of `reports.REPORTERS`."""

    HTML = "html"
    MD = "md"
    JSON = "json"
    TERMINAL = "terminal"


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="rich")


@app.command(context_settings={"help_option_names": ["-h", "--help"]})
def main_command(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            help="With traces at any depth: .mcap files, rosbag2 folders. Or one of these.",
            show_default=False,
        ),
    ],
    report: Annotated[
        list[ReportKind] | None,
        typer.Option(
            metavar="KIND",
            help="html, md, json or terminal [dim](default)[/dim]; repeatable.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Where files go. [dim]Default: analysis/ in the folder of the traces[/dim]",
            show_default=False,
        ),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Let the workers of a Dask scheduler do it, such as tcp://scheduler:8786; they read the traces "
            "themselves, from shared folders or object storage (s3://bucket/runs as FOLDER).",
            show_default=False,
        ),
    ] = None,
    sketch: Annotated[
        bool,
        typer.Option(
            "--sketch", help="Percentiles from histograms (off by 0.05 % at most), and no roundtrips.parquet."
        ),
    ] = False,
    no_cache: Annotated[
        bool,
        typer.Option("--no-cache", help="Read every trace anew, and keep nothing for the next analysis."),
    ] = False,
) -> None:
    """Analyze traces: latency, losses and rates for every middleware, domain, size and frequency.

    Writes roundtrips.parquet and summary.parquet and the reports asked for; those of an earlier analysis are
    replaced. Results go to stdout, progress and warnings to stderr:

    [bold]dds-analyze runs/ --report html[/bold]
    """
    from analyzer import Severity, analyze, default_output
    from reports import write_report

    target = default_output(folder) if out is None else out
    with _reading_bar() as progress:
        analysis = analyze(
            folder, out=target, progress=progress, cache=not no_cache, cluster=cluster, sketch=sketch
        )
    reports = [write_report(analysis, kind.value, target) for kind in report or [ReportKind.TERMINAL]]
    for path in (*analysis.outputs.values(), *reports):
        if path is not None:
            print(f"Wrote {path}")
    for finding in analysis.findings:
        if finding.severity is Severity.ERROR:
            print(f"{finding.where}: {finding.what} {finding.action}", file=sys.stderr)


COMMANDS: Mapping[str, typer.Typer] = {}
"""Name -> command, beside the one without a name."""


def main(arguments: Sequence[str] | None = None) -> None:
    """The entry point of `dds-analyze`; `arguments` default to those of the process."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given and given[0] in COMMANDS:
        run_command(partial(COMMANDS[given[0]], given[1:], prog_name=f"dds-analyze {given[0]}"))
    else:
        run_command(partial(app, given, prog_name="dds-analyze"))


@contextmanager
def _reading_bar() -> Iterator[Callable[[int, int, Path], None] | None]:
    """A bar on stderr that shows which trace is read; None where stderr is no terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("")
        yield lambda done, total, path: bar.update(
            task, completed=done, total=total, description=f"reading {path.name}"
        )


if __name__ == "__main__":
    main()

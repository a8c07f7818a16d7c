"""`dds-trace analyze runs/`, and `choose`: a folder of traces becomes tables, reports and Parquet files."""

from __future__ import annotations

import glob
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dds_trace.analyzer.exports.kinds import EXPORT_KINDS
from dds_trace.base import limits
from dds_trace.base.errors import MissingEventsError, OptionError
from dds_trace.base.extension import load
from dds_trace.base.streams import plain_console, say
from dds_trace.base.threads import tune_gc
from dds_trace.base.units import parse_duration, spell_size
from dds_trace.reports.reporters import REPORT_MODULES

from .program import Version, argument, ask_about_folder, command, make_app, option, run_command, starting
from .vector_sorts import avoid_slow_sorts

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from typer.models import OptionInfo

    from dds_trace.analyzer.analysis import Analysis


def expand_paths(texts: Sequence[str]) -> list[Path]:
    paths: list[Path] = []
    for text in texts:
        limits.check(limits.INPUT, text, "PATH")
        if not glob.has_magic(text) or Path(text).exists() or "://" in text:
            paths.append(Path(text))
            continue
        matches = sorted(glob.glob(text, recursive=True))  # noqa: PTH207 - pathlib's takes no absolute pattern
        if not matches:
            raise MissingEventsError(f"{text}: no file or folder matches; give the folder with the traces")
        paths += map(Path, matches)
    return paths


MOST_KINDS = 12
DESKTOP_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


HTML, TERMINAL = "html", "terminal"
"""Kinds of report: `--open` opens a page, and the answer is always printed."""


def kinds_of(table: Collection[str], name: str, help_: str) -> OptionInfo:
    def check(kinds: list[str] | None) -> list[str] | None:
        for kind in kinds or ():
            if kind not in table:
                raise typer.BadParameter(f"{kind!r} is not one of {', '.join(map(repr, table))}.")
        return kinds

    return option(name, f"{help_}: {', '.join(table)}; repeatable.", callback=check, autocompletion=starting(table))


app, choose = make_app(completes=True), make_app()

Paths = Annotated[
    list[str],
    argument(
        "PATH...",
        "Folders with traces at any depth, .mcap files, rosbag2 folders, or patterns such as 'runs/*/pi4*.mcap'.",
    ),
]
Reports = Annotated[
    list[str] | None, kinds_of(REPORT_MODULES, "--report KIND", "Report to write in addition to the answer")
]
Out = Annotated[
    Path | None, option("--out FOLDER", "Folder for all files. Default: analysis/ in the common folder of all traces")
]
ShowsAll = Annotated[bool, option("--all", "Print findings and tables of all results, too, and the answer last.")]
Opens = Annotated[bool, option("--open", "Write the HTML report and open it in a browser.")]


@command(app, "analyze", table="analyze", often=("report", "shows_all", "out", "deadline", "fail_if", "open_it"))
def analyze_command(
    paths: Paths,
    report: Reports = None,
    shows_all: ShowsAll = False,
    out: Out = None,
    cluster: Annotated[
        str | None,
        option(
            "--cluster ADDRESS",
            "Use the workers of a Dask scheduler, e.g. tcp://scheduler:8786; they read the traces from shared folders "
            "or object storage (s3://bucket/runs as PATH).",
        ),
    ] = None,
    sketch: Annotated[
        bool,
        option("--sketch", "Compute percentiles from histograms (error at most 0.05 %); write no roundtrips.parquet."),
    ] = False,
    deadline: Annotated[
        str | None,
        option(
            "--deadline TIME",
            "Count messages later than this, e.g. 20ms from planned send to reply, or '20ms metric=outbound'.",
        ),
    ] = None,
    margin: Annotated[
        str | None,
        option(
            "--margin PERCENT", "Call a setup fastest only if the next takes at least this much longer. Default: 5%"
        ),
    ] = None,
    trust_order: Annotated[
        bool, option("--trust-order", "Compare setups that were recorded one after the other, too.")
    ] = False,
    export: Annotated[
        list[str] | None, kinds_of(EXPORT_KINDS, "--export KIND", "Further file to write in addition to Parquet")
    ] = None,
    derived_mcap: Annotated[
        bool, option("--derived-mcap", "Write the latency of every message as MCAP, and a layout for Foxglove.")
    ] = False,
    fail_if: Annotated[
        list[str] | None,
        option(
            "--fail-if LIMIT", "Fail if it holds, of topics that taps heard: 'age_p99(/camera) > 50ms'; repeatable."
        ),
    ] = None,
    open_it: Opens = False,
    version: Version = False,  # noqa: ARG001 - its callback does it
) -> None:
    """Analyze traces: latency, losses and rates of every result.

    Writes roundtrips.parquet and summary.parquet and the reports asked for; earlier ones are
    replaced. Results go to stdout, progress and warnings to stderr:

        dds-trace analyze runs/ --report html
    """
    from dds_trace.recorder.option import parse_percentage

    limits.check(limits.SCHEDULER, cluster, "--cluster")
    deadline_ns, deadline_metric = _parse_deadline(deadline)
    gates = load("parts", "topic_limits")(fail_if) if fail_if else ()
    more = {
        "cluster": cluster,
        "sketch": sketch,
        "deadline_ns": deadline_ns,
        "deadline_metric": deadline_metric,
        "margin": 0.05 if margin is None else parse_percentage("--margin", margin),
        "trust_order": trust_order,
    }
    analysis = _analyze(
        paths, out, report, more, exports=export, derived_mcap=derived_mcap, open_it=open_it, shows_all=shows_all
    )
    if gates:
        raise typer.Exit(load("parts", "judge_topics")(analysis, gates))


@command(choose, "choose", often=("size", "rate", "deadline", "reliability", "data", "report", "out", "open_it"))
def choose_command(
    paths: Paths,
    size: Annotated[str, option("--size SIZE", "Size of a message: 33KB, 4MB.")],
    rate: Annotated[str, option("--rate HZ", "Messages a second.")],
    deadline: Annotated[str, option("--deadline TIME", "Time within which a reply has to come, e.g. 50ms.")],
    reliability: Annotated[
        str, option("--reliability SHARE", "Share of the messages that have to come in time.", show_default=True)
    ] = "0.99",
    data: Annotated[
        str, option("--data KIND", "Data of the messages: binary, string, imu.", show_default=True)
    ] = "binary",
    domain: Annotated[
        str | None, option("--domain MODE", "same or different: only setups of one domain, or of two. Default: both")
    ] = None,
    metric: Annotated[
        str,
        option(
            "--metric NAME",
            "What the deadline is for: response (planned send to reply), or another.",
            show_default=True,
        ),
    ] = "response",
    report: Reports = None,
    shows_all: ShowsAll = False,
    out: Out = None,
    open_it: Opens = False,
) -> None:
    """Rank the measured setups for a size, a rate and a deadline.

    For example:

        dds-trace choose runs/ --size 502KB --rate 20 --deadline 50ms
    """
    from dds_trace.analyzer.verdicts.job import make_job

    job = make_job(
        size=size, rate=rate, deadline=deadline, reliability=reliability, data=data, domain=domain, metric=metric
    )
    analysis = _analyze(paths, out, report, {"job": job}, open_it=open_it, shows_all=shows_all)
    recommendation = analysis.details.recommendation
    if recommendation is not None and not recommendation.candidates:
        kinds = analysis.summary.select("data_type", "payload_bytes", "rate_hz").unique(maintain_order=True)
        shown = [f"{data} {spell_size(size)} at {rate:g} Hz" for data, size, rate in kinds.head(MOST_KINDS).iter_rows()]
        say(f"measured: {', '.join(shown)}{' ...' if kinds.height > MOST_KINDS else ''}")


def _analyze(
    paths: Sequence[str],
    out: Path | None,
    report: Sequence[str] | None,
    more: Mapping[str, Any],
    *,
    exports: Sequence[str] | None = None,
    derived_mcap: bool = False,
    open_it: bool = False,
    shows_all: bool = False,
) -> Analysis:
    from dds_trace.analyzer.exports.kinds import export as write_export
    from dds_trace.analyzer.pairing.parquet import read_provenance
    from dds_trace.analyzer.pipeline import WRITING, analyze, default_output
    from dds_trace.analyzer.saving.results import RESULT_NAMES
    from dds_trace.reports.reporters import write_reports

    limits.check(limits.FOLDER, None if out is None else str(out), "--out")
    traces = expand_paths(paths)
    target = default_output(traces) if out is None else out
    ask_about_folder(target, "for all files")
    kinds = list(dict.fromkeys([*(report or []), *([HTML] if open_it else [])]))
    written: list[Path] = []

    def write_more(analysis: Analysis, folder: Path) -> None:
        bar.step(WRITING, 0.0)
        reports = write_reports(analysis, [kind for kind in kinds if kind != TERMINAL], folder)
        exported = [path for kind in exports or [] for path in write_export(analysis, kind, folder)]
        derived = _write_derived(analysis, folder) if derived_mcap else []
        files = [*reports, *exported, *derived]
        written.extend(target / path.name for path in files if path is not None)

    earlier = read_provenance(target)
    with AnalysisBar() as bar:
        analysis = analyze(traces, out=target, progress=bar.reading, step=bar.step, **more, write_more=write_more)
    write_reports(analysis, [TERMINAL], target, shows_all=shows_all)
    written[:0] = analysis.outputs.values()
    for path in written:
        print(f"Wrote {path}")
    stale = [name for name in RESULT_NAMES if target / name not in written and (target / name).is_file()]
    if stale and earlier is not None and earlier != read_provenance(target):
        say(f"{target}: {', '.join(stale)}: of an earlier analysis of other traces, and not replaced")
    show_page([path for path in written if path.suffix == ".html"], open_it=open_it)
    return analysis


def show_page(pages: list[Path], *, open_it: bool) -> None:
    import webbrowser

    for page in pages:
        has_desktop = any(map(os.environ.get, DESKTOP_VARIABLES))
        if open_it and not (has_desktop and webbrowser.open(page.absolute().as_uri())):
            print(
                "no desktop here: open the file below in a browser, here or copied to another machine", file=sys.stderr
            )
        print(page.absolute().as_uri())


def _parse_deadline(text: str | None) -> tuple[int | None, str]:
    from dds_trace.analyzer.groups.batch import DEADLINE_METRIC, DEADLINE_METRICS

    if text is None:
        return None, DEADLINE_METRIC
    time, *metric_name = text.split() or [""]
    metrics = [word.removeprefix("metric=") for word in metric_name if word.startswith("metric=")]
    if len(metric_name) > 1 or len(metrics) != len(metric_name):
        raise OptionError(f"--deadline {text!r}: write a time, then metric=NAME: '20ms metric=outbound'")
    metric = metrics[0] if metrics else DEADLINE_METRIC
    if metric not in DEADLINE_METRICS:
        raise OptionError(
            f"--deadline {text!r}: there is no metric {metric!r}; write metric= and one of {', '.join(DEADLINE_METRICS)}"
        )
    return parse_duration(time, "--deadline"), metric


def _write_derived(analysis: Analysis, target: Path) -> list[Path]:
    from dds_trace.analyzer.clocks.boots import ping_wall_offsets

    wall = ping_wall_offsets(analysis.sessions, analysis.runs)
    derived = load("parts", "derived")(analysis.load_roundtrips(), target / "latency.derived.mcap", wall, force=True)
    return [derived.path, derived.layout]


SHARES = {"reading": 0.3, "pairing": 0.35, "judging": 0.2, "writing": 0.15}
"""Share of the time of each step, of 300 to 1,500 runs."""


class AnalysisBar:
    def __init__(self) -> None:
        self.share = 0.0
        self._progress: Any = None

    def __enter__(self) -> AnalysisBar:  # noqa: PYI034 - `Self` is Python 3.11's
        if sys.stderr.isatty():
            from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

            columns = (
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TaskProgressColumn(),
                TimeElapsedColumn(),
            )
            console = plain_console(stderr=True)
            self._progress = Progress(*columns, console=console, transient=True, redirect_stdout=False)
            self._progress.add_task("reading", total=1.0)
            self._progress.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._progress is not None:
            self._progress.stop()

    def reading(self, done: int, total: int, path: Path) -> None:
        self._draw("reading", done / total, f"reading {path.name[:30]}")

    def step(self, name: str, share: float) -> None:
        self._draw(name, share, name)

    def _draw(self, name: str, share: float, words: str) -> None:
        names = list(SHARES)
        self.share = max(self.share, sum(SHARES[step] for step in names[: names.index(name)]) + SHARES[name] * share)
        if self._progress is not None:
            self._progress.update(self._progress.tasks[0].id, completed=self.share, description=words)


def main(arguments: Sequence[str] | None = None) -> None:
    from .trace import main as dds_trace
    from .trace import run_alias

    words = list(sys.argv[1:] if arguments is None else arguments)
    if words[:1] in (["compare"], ["watch"]):
        dds_trace(words)
    tune_gc()
    avoid_slow_sorts()
    run_command(lambda: run_alias("dds-analyze", app, ["analyze", *words]))


if __name__ == "__main__":
    main()

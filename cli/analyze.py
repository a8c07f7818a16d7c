"""`dds-analyze runs/`: a folder of traces becomes tables, reports and Parquet files."""

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
from dds_trace.base.streams import plain_console, say
from dds_trace.base.threads import tune_gc
from dds_trace.base.units import parse_duration
from dds_trace.reports.reporters import REPORT_MODULES

from . import compare, watch
from .program import ask_about_folder, run_program
from .quick_help import Version, argument, command_app, declare_command, option, starting
from .vector_sorts import avoid_slow_sorts

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from typer.models import OptionInfo

    from dds_trace.analyzer.analysis import Analysis
    from dds_trace.analyzer.verdicts.gate import Gate


def expand_paths(texts: Sequence[str]) -> list[Path]:
    """Return the paths that exist or match a pattern.

    Raises:
        OptionError: a text cannot be a path.
        MissingEventsError: nothing matches a pattern.
    """
    paths: list[Path] = []
    for text in texts:
        limits.check(limits.INPUT, text, "PATH")
        if not glob.has_magic(text) or Path(text).exists() or "://" in text:
            paths.append(Path(text))
            continue
        matches = sorted(glob.glob(text, recursive=True))  # noqa: PTH207 - pathlib's takes no absolute pattern
        if not matches:
            raise MissingEventsError(f"{text}: no file or folder matches; give the folder that dds-record wrote into")
        paths += map(Path, matches)
    return paths


DESKTOP_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


HTML, TERMINAL = "html", "terminal"
"""Kinds of report: `--open` opens a page, and the answer is always printed."""


def _kinds_of(table: Mapping[str, object], name: str, help_: str) -> OptionInfo:
    def check(kinds: list[str] | None) -> list[str] | None:
        for kind in kinds or ():
            if kind not in table:
                raise typer.BadParameter(f"{kind!r} is not one of {', '.join(map(repr, table))}.")
        return kinds

    return option(name, f"{help_}: {', '.join(table)}; repeatable.", callback=check, autocompletion=starting(table))


app = command_app(completes=True)


NOT_OF_TOPICS = (
    *("cluster", "sketch", "deadline", "recommend", "margin", "trust_order"),
    *("derived_mcap", "card", "shows_all"),
)


def _check_topics(values: Mapping[str, Any]) -> None:
    for name, flag in (("clock", "--clock"), ("limits_file", "--limits"), ("write_limits", "--write-limits")):
        if values[name] is not None and not values["topics"]:
            raise OptionError(f"{flag} is for recordings of other tools: dds-analyze bag/ --topics {flag} ...")
    refused = [name for name in NOT_OF_TOPICS if values[name] and values["topics"]]
    if refused:
        spelled = {"shows_all": "all"}
        options = ", ".join(f"--{spelled.get(name, name).replace('_', '-')}" for name in refused)
        raise OptionError(f"--topics reads recordings, not traces of ours; leave out {options}")


@declare_command(
    app,
    "analyze",
    lambda values: dict.fromkeys(NOT_OF_TOPICS if values.get("topics") else (), "default: not of --topics"),
)
def main_command(
    paths: Annotated[
        list[str],
        argument(
            "PATH...",
            "Folders with traces at any depth, .mcap files, rosbag2 folders, or patterns such as 'runs/*/pi4*.mcap'.",
            autocompletion=lambda incomplete: [name for name in COMMANDS if name.startswith(incomplete)],
        ),
    ],
    report: Annotated[
        list[str] | None, _kinds_of(REPORT_MODULES, "--report KIND", "Report to write in addition to the answer")
    ] = None,
    shows_all: Annotated[
        bool, option("--all", "Print findings and tables of all results, too, and the answer last.")
    ] = False,
    out: Annotated[
        Path | None,
        option("--out FOLDER", "Folder for all files. Default: analysis/ in the common folder of all traces"),
    ] = None,
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
    recommend: Annotated[
        str | None,
        option(
            "--recommend JOB",
            "Rank the setups for a job: 'data=binary size=502KB rate=20 deadline=50ms reliability=0.999'.",
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
        list[str] | None, _kinds_of(EXPORT_KINDS, "--export KIND", "Further file to write in addition to Parquet")
    ] = None,
    derived_mcap: Annotated[
        bool, option("--derived-mcap", "Write the latency of every message as MCAP, and a layout for Foxglove.")
    ] = False,
    topics: Annotated[
        bool,
        option(
            "--topics",
            "For recordings of other tools: is the bag whole? What is missing of every topic, when, rate, jitter and age.",
        ),
    ] = False,
    clock: Annotated[
        str | None,
        option(
            "--clock FOLDER",
            "With --topics: correct the ages by the clocks in traces of ping and relay between both devices: runs/, or "
            "'runs/ stamped=robot recorded=laptop topics=/camera/*'.",
        ),
    ] = None,
    fail_if: Annotated[
        list[str] | None,
        option(
            "--fail-if LIMIT",
            "Fail if it holds, of topics that taps heard: 'age_p99(/camera) > 50ms'; with --topics: 'missing(/camera) > 1%'; "
            "repeatable.",
        ),
    ] = None,
    limits_file: Annotated[
        Path | None, option("--limits FILE", "With --topics: a limits.toml, with limits by topic.")
    ] = None,
    write_limits: Annotated[
        Path | None, option("--write-limits FILE", "With --topics: write a limits.toml from good recordings.")
    ] = None,
    card: Annotated[
        bool,
        option("--card", "Write the verdict as a picture for a README: card.svg, and card.png with the extra card."),
    ] = False,
    open_it: Annotated[bool, option("--open", "Write the HTML report and open it in a browser.")] = False,
    version: Version = False,
) -> None:
    """Analyze traces: latency, losses and rates for every middleware, domain, size and frequency.

    Writes roundtrips.parquet and summary.parquet and the reports asked for; earlier ones are
    replaced. Results go to stdout, progress and warnings to stderr:

        dds-analyze runs/ --report html

    Compare two sets of traces, and show a page that follows a running sweep:

        dds-analyze compare BASE NEW

        dds-analyze watch runs/

    Is this bag whole? Exit code 30 with holes, 31 if it is damaged:

        dds-analyze drive/ --topics
    """
    values = locals()
    from dds_trace.analyzer.exports.kinds import export as write_export
    from dds_trace.analyzer.model.finding import Severity
    from dds_trace.analyzer.pairing.parquet import read_provenance
    from dds_trace.analyzer.pipeline import WRITING, analyze, default_output
    from dds_trace.analyzer.saving.results import RESULT_NAMES
    from dds_trace.analyzer.verdicts.job import parse_job
    from dds_trace.recorder.option_values import parse_percentage
    from dds_trace.reports.reporters import write_reports

    _check_topics(values)
    limits.check(limits.FOLDER, None if out is None else str(out), "--out")
    limits.check(limits.SCHEDULER, cluster, "--cluster")
    traces = expand_paths(paths)
    target = default_output(traces) if out is None else out
    ask_about_folder(target, "for all files")
    deadline_ns, deadline_metric = _parse_deadline(deadline)
    job = None if recommend is None else parse_job(recommend)
    least_lead = 0.05 if margin is None else parse_percentage("--margin", margin)
    kinds = list(dict.fromkeys([*(report or []), *([HTML] if open_it else [])]))
    if topics:
        report_limits = fail_if or [], limits_file, write_limits
        _report_topics(traces, target, kinds, export or [], report_limits, clock, open_it=open_it)
        return
    gates = _parse_limits(fail_if or [])
    written: list[Path] = []

    def write_more(analysis: Analysis, folder: Path) -> None:
        bar.step(WRITING, 0.0)
        reports = write_reports(analysis, [kind for kind in kinds if kind != TERMINAL], folder)
        exported = [path for kind in export or [] for path in write_export(analysis, kind, folder)]
        derived = _write_derived(analysis, folder) if derived_mcap else []
        cards = _write_card(analysis, folder) if card else []
        written.extend(target / path.name for path in (*reports, *exported, *derived, *cards) if path is not None)

    earlier = read_provenance(target)
    with AnalysisBar() as bar:
        analysis = analyze(
            traces,
            out=target,
            progress=bar.reading,
            step=bar.step,
            cluster=cluster,
            sketch=sketch,
            deadline_ns=deadline_ns,
            deadline_metric=deadline_metric,
            job=job,
            margin=least_lead,
            trust_order=trust_order,
            write_more=write_more,
        )
    for finding in analysis.findings:
        if finding.severity is Severity.ERROR:
            say(f"{finding.where}: {finding.what} {finding.action}")
    write_reports(analysis, [TERMINAL], target, shows_all=shows_all)
    written[:0] = analysis.outputs.values()
    for path in written:
        print(f"Wrote {path}")
    stale = [name for name in RESULT_NAMES if target / name not in written and (target / name).is_file()]
    if stale and earlier is not None and earlier != read_provenance(target):
        say(f"{target}: {', '.join(stale)}: of an earlier analysis of other traces, and not replaced")
    _show_page([path for path in written if path.suffix == ".html"], open_it=open_it)
    if gates:
        _judge_topics(analysis, gates)


def _parse_limits(texts: list[str]) -> list[Gate]:
    from dds_trace.analyzer.model.metrics import METRICS
    from dds_trace.analyzer.verdicts.gate import Against, parse_gates

    gates = parse_gates(texts)
    if any(gate.against is not Against.NEW or gate.metric in METRICS for gate in gates):
        raise OptionError(
            "--fail-if takes limits of topics here, such as 'age_p99(/camera/image) > 50ms'; limits of latency: "
            "dds-analyze compare RUNS --fail-if 'latency_p99 > 20ms'"
        )
    return gates


def _judge_topics(analysis: Analysis, gates: list[Gate]) -> None:
    from dds_trace.analyzer.verdicts.compare import CompareOptions, compare
    from dds_trace.analyzer.verdicts.gate import GateOutcome
    from dds_trace.analyzer.verdicts.gates import judge_gates, options_for, overall_outcome
    from dds_trace.reports.comparison.info import comparison_info

    comparison = compare(analysis, analysis, options_for(gates, CompareOptions()))
    results = judge_gates(comparison, gates)
    for gated in comparison_info(comparison, results).gates:
        print(gated.line)
    outcome = overall_outcome(result.outcome for result in results)
    print(f"dds-analyze: {outcome.value}", file=sys.stderr)
    if outcome is not GateOutcome.PASSED:
        raise typer.Exit(outcome.exit_code)


def _show_page(pages: list[Path], *, open_it: bool) -> None:
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


def _report_topics(
    paths: list[Path],
    target: Path,
    kinds: list[str],
    exports: list[str],
    limits_: tuple[list[str], Path | None, Path | None],
    clock: str | None,
    *,
    open_it: bool,
) -> None:
    from dds_trace.analyzer.pipeline import analyze
    from dds_trace.analyzer.topics.device_clocks import ClockRequest, StampClock
    from dds_trace.analyzer.verdicts.gate import parse_topic_gate

    from .limits_file import read_limits
    from .topics import report_topics

    texts, limits_file, write_limits = limits_
    for path, flag in ((limits_file, "--limits"), (write_limits, "--write-limits")):
        limits.check(limits.PATH, None if path is None else str(path), flag)
    gates = [parse_topic_gate(text) for text in texts]  # before anything is read
    gates += [] if limits_file is None else read_limits(limits_file, of_recording=True)
    request = None if clock is None else ClockRequest.parse(clock)
    stamp_clock = None
    if request is not None:
        measured = analyze(request.folder, details=False)
        stamp_clock = StampClock(request, measured.sessions, measured.runs, measured.rows)
    code, written = report_topics(paths, target, kinds, exports, gates, stamp_clock, write_limits)
    for path in written:
        print(f"Wrote {path}")
    _show_page([path for path in written if path.suffix == ".html"], open_it=open_it)
    if code:
        raise typer.Exit(code)


def _write_card(analysis: Analysis, folder: Path) -> list[Path]:
    from dds_trace.reports.book.book import Book
    from dds_trace.reports.card import write_card

    return write_card(Book(analysis), folder, say)


def _write_derived(analysis: Analysis, target: Path) -> list[Path]:
    from dds_trace.analyzer.clocks.boots import ping_wall_offsets
    from dds_trace.analyzer.exports.foxglove import write_derived

    wall = ping_wall_offsets(analysis.sessions, analysis.runs)
    derived = write_derived(analysis.load_roundtrips(), target / "latency.derived.mcap", wall, force=True)
    return [derived.path, derived.layout]


SHARES = {"reading": 0.3, "pairing": 0.35, "judging": 0.2, "writing": 0.15}
"""Share of the time that each step takes, of campaigns from 300 to 1,500 runs without a cache."""


class AnalysisBar:
    """Draws which step works, and how much of all is done; it never goes back and shows no guessed time."""

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


COMMANDS: Mapping[str, typer.Typer] = {"compare": compare.app, "watch": watch.app}


def main(
    arguments: Sequence[str] | None = None, *, name: str = "dds-analyze", adapt: Callable[[Any], object] | None = None
) -> None:
    tune_gc()
    avoid_slow_sorts()
    run_program(name, app, COMMANDS, arguments, adapt=adapt)


if __name__ == "__main__":
    main()

"""`dds-trace bag DRIVE`: the health of other tools' recordings, its files, limits and exit code."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dds_trace.analyzer.exports.kinds import EXPORTERS, TOPIC_EXPORTS, write_file, write_text_file
from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.units import counted
from dds_trace.cli.outputs import Opens, expand_paths, kinds_of, show_page
from dds_trace.cli.program import argument, ask_about_folder, command, make_app, option

from .kinds import SUFFIX_WORDS

if TYPE_CHECKING:
    from dds_trace.extensions.exports.perfetto import Slice
    from dds_trace.extensions.gates.gate import Gate

    from .analyze import StampCorrector, TopicReport

_REPORTS = ("html", "md", "json", "terminal")
HOLES_EXIT_CODE, DAMAGED_EXIT_CODE = 30, 31
_FILES = ("html", "md", "json")

app = make_app()


@command(app, "bag", often=("report", "out", "fail_if", "clock", "open_it"))
def bag_command(
    paths: Annotated[
        list[str], argument("DRIVE...", f"Recordings of other tools: {SUFFIX_WORDS} files, their folders, or patterns.")
    ],
    report: Annotated[
        list[str] | None, kinds_of(_REPORTS, "--report KIND", "Report to write in addition to the answer")
    ] = None,
    out: Annotated[
        Path | None,
        option("--out FOLDER", "Folder for all files. Default: analysis/ in the common folder of all recordings"),
    ] = None,
    export: Annotated[list[str] | None, kinds_of(TOPIC_EXPORTS, "--export KIND", "Further file to write")] = None,
    fail_if: Annotated[
        list[str] | None,
        option(
            "--fail-if LIMIT",
            "Fail if a topic is beyond this limit: 'missing(/camera) > 1%', 'age_p99(/camera) > 50ms'; repeatable.",
        ),
    ] = None,
    limits_file: Annotated[Path | None, option("--limits FILE", "A limits.toml, with limits by topic.")] = None,
    write_limits: Annotated[
        Path | None, option("--write-limits FILE", "Write a limits.toml from good recordings.")
    ] = None,
    clock: Annotated[
        str | None,
        option(
            "--clock FOLDER",
            "Correct the ages by the clocks in traces of ping and relay between both devices: runs/, or 'runs/ stamped=robot "
            "recorded=laptop topics=/camera/*'.",
        ),
    ] = None,
    sync: Annotated[
        str | None, option("--sync TOPIC,TOPIC", "Compare the clocks that stamp two topics: /camera,/imu")
    ] = None,
    open_it: Opens = False,
) -> None:
    """Check that a recording of other tools is whole, topic by topic.

    Exit code 30 with holes, 31 if it is damaged; with --fail-if the limits decide.

        dds-trace bag drive/ --report html --fail-if 'missing(/camera) > 1%'
    """
    from dds_trace.analyzer.loading.place import default_output

    limits.check(limits.FOLDER, None if out is None else str(out), "--out")
    recordings = expand_paths(paths)
    folder = default_output(recordings) if out is None else out
    ask_about_folder(folder, "for all files")
    for path, flag in ((limits_file, "--limits"), (write_limits, "--write-limits")):
        limits.check(limits.PATH, None if path is None else str(path), flag)
    gates: list[Gate] = []
    if fail_if or limits_file is not None:  # before anything is read
        from dds_trace.extensions.gates.gate import parse_topic_gate
        from dds_trace.extensions.gates.limits_file import read_limits

        gates = [parse_topic_gate(text) for text in fail_if or []]
        gates += [] if limits_file is None else read_limits(limits_file, of_recording=True)
    compared = [] if sync is None else sync.split(",")
    if sync is not None and (len(compared) != 2 or not all(compared)):
        raise OptionError(f"--sync {sync}: name two topics, such as /camera,/imu")
    stamp_clock = None
    if clock is not None:
        from dds_trace.analyzer.pipeline import analyze
        from dds_trace.extensions.topics.device_clocks import ClockRequest, StampClock

        request = ClockRequest.parse(clock)
        measured = analyze(request.folder, details=False)
        stamp_clock = StampClock(request, measured.sessions, measured.runs, measured.rows).corrections
    kinds = [*(report or []), *(["html"] if open_it else [])]
    code, written = report_topics(recordings, folder, kinds, export or [], gates, stamp_clock, write_limits, compared)
    for path in written:
        print(f"Wrote {path}")
    show_page([path for path in written if path.suffix == ".html"], open_it=open_it)
    raise typer.Exit(code)


def report_topics(
    paths: Sequence[Path],
    folder: Path,
    kinds: Sequence[str],
    exports: Sequence[str],
    gates: Sequence[Gate],
    clock: StampCorrector | None = None,
    limits_out: Path | None = None,
    sync: Sequence[str] = (),
) -> tuple[int, list[Path]]:
    from dds_trace.base.streams import say
    from dds_trace.reports.reporters import load_reporter
    from dds_trace.reports.terminal import print_report

    from .analyze import analyze_topics
    from .card import DAMAGED, EMPTY, HOLES
    from .report import BagReport

    report = analyze_topics(paths, skip=[folder], clock=clock, sync=sync)
    judged = []
    if gates:
        from .limits import judge_topics

        judged = list(judge_topics(report.topics, report.holes, gates))
    contents = BagReport(report, judged)
    print_report(contents)
    for source in report.sources:
        if source.status == "skipped":
            say(f"{source.path}: skipped: {source.detail}")
    written = [
        write_text_file(folder / f"{contents.name}.{kind}", load_reporter(kind).render(contents))
        for kind in dict.fromkeys(kinds)
        if kind in _FILES
    ]
    for kind in exports:
        if kind == "perfetto":
            from dds_trace.extensions.exports.perfetto import write_slices

            written.append(write_file(folder / "topics.pftrace", partial(write_slices, _topic_slices(report))))
        else:
            written.append(write_file(folder / f"topics.{kind}", partial(EXPORTERS[kind], report.topics.lazy())))
    if limits_out is not None:
        from dds_trace.extensions.gates.limits_file import topic_limits_text, write_limits

        write_limits(topic_limits_text(report.topics), limits_out)
    if report.verdict in (DAMAGED, EMPTY):
        return DAMAGED_EXIT_CODE, written
    if gates:  # they say which holes are too many
        from dds_trace.extensions.gates.gates import overall_outcome

        return overall_outcome(gated.result.outcome for gated in judged).exit_code, written
    return HOLES_EXIT_CODE if report.verdict == HOLES else 0, written


def _topic_slices(report: TopicReport) -> Iterator[Slice]:
    from dds_trace.extensions.exports.perfetto import Slice

    starts_ns, numbers = {health.path: health.start_ns for health in report.recordings}, count(1)
    for row in report.topics.iter_rows(named=True):
        recording, topic, at_ns = row["recording"], row["topic"], row["start_ns"]
        parts: list[tuple[str, int, int]] = []
        for hole in report.holes.filter(recording=recording, topic=topic).iter_rows(named=True):
            begin_ns = starts_ns[recording] + round(hole["start_s"] * 1e9)
            end_ns = begin_ns + round(hole["duration_s"] * 1e9)
            name = f"hole: {counted(hole['missing'], 'message')}" if hole["missing"] else "no messages"
            parts += [("messages", at_ns, begin_ns), (name, begin_ns, end_ns)]
            at_ns = end_ns
        parts.append(("messages", at_ns, row["start_ns"] + row["duration_ns"]))
        for name, begin_ns, end_ns in parts:
            if end_ns > begin_ns:
                yield Slice(recording, topic, name, begin_ns, end_ns, next(numbers))

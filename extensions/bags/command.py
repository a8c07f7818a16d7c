"""`dds-trace bag DRIVE`: the health of other tools' recordings, its files, limits and exit code."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dds_trace.analyzer.exports.kinds import EXPORT_KINDS
from dds_trace.base import limits
from dds_trace.cli.analyze import Opens, expand_paths, kinds_of, show_page
from dds_trace.cli.program import argument, ask_about_folder, command, make_app, option

_REPORTS = ("html", "md", "json", "terminal")

app = make_app()


@command(app, "bag", often=("report", "out", "fail_if", "clock", "open_it"))
def bag_command(
    paths: Annotated[list[str], argument("DRIVE...", "Recordings of other tools: bags, .mcap files, or patterns.")],
    report: Annotated[
        list[str] | None, kinds_of(_REPORTS, "--report KIND", "Report to write in addition to the answer")
    ] = None,
    out: Annotated[
        Path | None,
        option("--out FOLDER", "Folder for all files. Default: analysis/ in the common folder of all recordings"),
    ] = None,
    export: Annotated[list[str] | None, kinds_of(EXPORT_KINDS, "--export KIND", "Further file to write")] = None,
    fail_if: Annotated[
        list[str] | None,
        option("--fail-if LIMIT", "Fail if it holds: 'missing(/camera) > 1%', 'age_p99(/camera) > 50ms'; repeatable."),
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
    open_it: Opens = False,
) -> None:
    """Say whether a recording of other tools is whole, topic by topic.

    Exit code 30 with holes, 31 if it is damaged; with --fail-if the limits decide.

        dds-trace bag drive/ --report html --fail-if 'missing(/camera) > 1%'
    """
    from dds_trace.analyzer.pipeline import analyze, default_output
    from dds_trace.extensions.gates.gate import parse_topic_gate
    from dds_trace.extensions.gates.limits_file import read_limits
    from dds_trace.extensions.topics.device_clocks import ClockRequest, StampClock

    from .printing import report_topics

    limits.check(limits.FOLDER, None if out is None else str(out), "--out")
    recordings = expand_paths(paths)
    folder = default_output(recordings) if out is None else out
    ask_about_folder(folder, "for all files")
    for path, flag in ((limits_file, "--limits"), (write_limits, "--write-limits")):
        limits.check(limits.PATH, None if path is None else str(path), flag)
    gates = [parse_topic_gate(text) for text in fail_if or []]  # before anything is read
    gates += [] if limits_file is None else read_limits(limits_file, of_recording=True)
    request = None if clock is None else ClockRequest.parse(clock)
    stamp_clock = None
    if request is not None:
        measured = analyze(request.folder, details=False)
        stamp_clock = StampClock(request, measured.sessions, measured.runs, measured.rows).corrections
    kinds = [*(report or []), *(["html"] if open_it else [])]
    code, written = report_topics(recordings, folder, kinds, export or [], gates, stamp_clock, write_limits)
    for path in written:
        print(f"Wrote {path}")
    show_page([path for path in written if path.suffix == ".html"], open_it=open_it)
    raise typer.Exit(code)

"""`dds-trace compare BASE NEW`: two folders of traces, as a table or as a gate for CI."""

from enum import Enum
from pathlib import Path
from typing import Annotated

import typer

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.extension import load
from dds_trace.cli.program import argument, command, make_app, option


class ReportKind(str, Enum):
    TERMINAL = "terminal"
    MD = "md"
    JSON = "json"
    JUNIT = "junit"
    GITHUB = "github"
    BADGE = "badge"
    HTML = "html"


_OF_DRIVES = ("terminal", "md", "json", "html")

app = make_app()

FailIf = Annotated[
    list[str] | None,
    option(
        "--fail-if GATE",
        "Condition that fails the comparison: 'latency_p99 > +10%', 'rtt_p50 > +2ms', 'latency_p99 > 20ms', "
        "'received_ratio < 99%', 'received_ratio < -0.5 points'; repeatable. 'default': p50 > +10%, p99 > +20%, "
        "received < -0.5 points.",
    ),
]
Strict = Annotated[bool, option("--strict", "Fail (21) where a gate is undecided, instead of warning (0).")]
Looks = Annotated[
    int,
    option(
        "--looks N",
        "Maximum number of looks at growing recordings until the gates decide; together they err as often as one.",
        show_default=True,
    ),
]


@command(app, "compare", table="compare", often=("fail_if", "limits_file", "report", "paired", "out"))
def compare_command(
    base: Annotated[Path, argument("BASE", "Traces before the change.")],
    new: Annotated[
        Path | None, argument("[NEW]", "Traces after the change. Without it, the limits apply to BASE.")
    ] = None,
    fail_if: FailIf = None,
    limits_file: Annotated[
        Path | None, option("--limits FILE", "A limits.toml: limits by result, and accepted changes.")
    ] = None,
    write_limits: Annotated[
        Path | None,
        option("--write-limits FILE", "Write a limits.toml from good runs, with margins from their spread."),
    ] = None,
    allow_missing: Annotated[
        bool, option("--allow-missing", "Allow results that are missing or receive nothing on the new side.")
    ] = False,
    strict: Strict = False,
    paired: Annotated[
        bool, option("--paired", "Compare repeat by repeat: both sides were measured in the same repeats of one sweep.")
    ] = False,
    looks: Looks = 1,
    report: Annotated[
        list[ReportKind] | None,
        option(
            "--report KIND",
            "Report to write: terminal, md, json, junit, html, github (annotations of a job) or badge (shields.io); "
            "repeatable, each with its --out. Default: terminal",
        ),
    ] = None,
    shows_all: Annotated[
        bool, option("--all", "Show every result and gate in terminal and md, not only the first.")
    ] = False,
    ignore: Annotated[
        str,
        option(
            "--ignore COLUMNS",
            "Compare results that differ in these columns, e.g. bridge,domain_mode; refused if two results of one side "
            "would become one.",
        ),
    ] = "",
    out: Annotated[list[Path] | None, option("--out FILE", "File or folder for the report. Default: stdout")] = None,
) -> None:
    """Compare two sets of traces or bags: what is slower or lost.

    A verdict needs at least three runs per side. A gate fails only if the whole confidence interval is beyond its limit, or
    if a result of the base is missing or receives nothing on the new side; one that cannot be decided is a warning, or exit
    code 21 with --strict. Exit codes: 0 passed, or no gate given; 20 regressed; 21 undecided; 22 no result in common.
    Two bags are compared topic by topic; their limits are of topics: 'rate(/imu) < -10%', 'missing(/imu) > 1%'.

        dds-trace compare main/ branch/ --fail-if default --report md
    """
    from .ignoring import match_without
    from .limits_file import limits_text, read_gates
    from .limits_file import write_limits as write_limits_file
    from .report import end_with, judge_sides, write_each

    limits.check(limits.LOOKS, looks, "--looks")
    reports = [kind.value for kind in report or [ReportKind.TERMINAL]]
    files: list[Path | None] = [*out] if out else [None for _ in reports]
    if len(files) != len(reports):
        raise OptionError(f"{len(reports)} --report and {len(files)} --out: give one file for each report, or none")
    if out and len({*out}) < len(out):
        raise OptionError(f"--out {out[-1]}: two reports would be one file; give each its own")
    inputs = {"BASE": base, "NEW": new}
    outputs = [("--limits", limits_file), ("--write-limits", write_limits), *(("--out", file) for file in files)]
    for bound, paths in ((limits.INPUT, inputs.items()), (limits.PATH, outputs)):
        for name, path in paths:
            limits.check(bound, None if path is None else str(path), name)
    if new is not None and load("parts", "are_drives")(base, new):
        if write_limits or paired or ignore or looks > 1 or not {*reports} <= {*_OF_DRIVES}:
            raise OptionError(
                f"two bags take --fail-if, --limits, --allow-missing, --strict and --report {', '.join(_OF_DRIVES)}"
            )
        drives = load("parts", "compare_drives")(base, new, fail_if or [], limits_file, allow_missing=allow_missing)
        write_each(drives, reports, files)
        raise typer.Exit(end_with(drives.outcome, drives.judged, strict=strict))
    gates = read_gates(fail_if or [], limits_file, one_side=new is None, needed=write_limits is None)
    match = match_without(filter(None, map(str.strip, ignore.split(","))))
    judged = judge_sides(base, new, gates, looks=looks, allow_missing=allow_missing, match=match, paired=paired)
    if write_limits is not None:
        write_limits_file(limits_text(judged.comparison), write_limits)
    title = " → ".join(side.name or str(side) for side in (base, new) if side is not None)
    for kind, file in zip(reports, files, strict=True):
        judged.write(kind, file, title, shows_all=shows_all)
    raise typer.Exit(judged.end(strict=strict))

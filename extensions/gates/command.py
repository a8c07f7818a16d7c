"""`dds-trace compare BASE NEW`: two folders of traces, as a table or as a gate for CI."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.extension import load
from dds_trace.base.streams import say
from dds_trace.cli.program import argument, command, make_app, option

if TYPE_CHECKING:
    from dds_trace.analyzer.analysis import Analysis
    from dds_trace.reports.blocks import Report

    from .compare import Comparison
    from .gate import Gate, GateOutcome
    from .info import ComparisonInfo


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
    from .gate import GateOutcome
    from .ignoring import match_without
    from .limits_file import limits_text
    from .limits_file import write_limits as write_limits_file

    limits.check(limits.LOOKS, looks, "--looks")
    reports = report or [ReportKind.TERMINAL]
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
        if write_limits or paired or ignore or looks > 1 or not {kind.value for kind in reports} <= {*_OF_DRIVES}:
            raise OptionError(
                f"two bags take --fail-if, --limits, --allow-missing, --strict and --report {', '.join(_OF_DRIVES)}"
            )
        drives = load("parts", "compare_drives")(base, new, fail_if or [], limits_file, allow_missing=allow_missing)
        for kind, file in zip(reports, files, strict=True):
            _write(drives, kind, file)
        raise typer.Exit(0 if drives.outcome is GateOutcome.INCONCLUSIVE and not strict else drives.outcome.exit_code)
    gates = read_gates(fail_if or [], limits_file, one_side=new is None, needed=write_limits is None)
    match = match_without(filter(None, map(str.strip, ignore.split(","))))
    judged = judge_sides(base, new, gates, looks=looks, allow_missing=allow_missing, match=match, paired=paired)
    if write_limits is not None:
        write_limits_file(limits_text(judged.comparison), write_limits)
    title = " → ".join(side.name or str(side) for side in (base, new) if side is not None)
    for kind, file in zip(reports, files, strict=True):
        judged.write(kind, file, title, shows_all=shows_all)
    raise typer.Exit(judged.end(strict=strict))


def _write(contents: "Report", kind: ReportKind, file: Path | None, text: str = "") -> None:
    from dds_trace.analyzer.exports.kinds import write_text_file
    from dds_trace.reports.reporters import load_reporter
    from dds_trace.reports.terminal import print_report

    if kind is ReportKind.TERMINAL and file is None:
        print_report(contents)
        return
    text = text or load_reporter(kind.value).render(contents)
    if file is not None:
        is_folder = file.is_dir() or not (file.suffix or file.exists())
        file = file / f"{contents.name}.{kind.value}" if is_folder else file
        print(f"Wrote {write_text_file(file, text)}")
    else:
        method = "write_commands" if kind is ReportKind.GITHUB else "write"
        getattr(sys.stdout, method, sys.stdout.write)(text)


class JudgedSides(NamedTuple):
    comparison: "Comparison"
    info: "ComparisonInfo"
    outcome: "GateOutcome"

    def write(self, report: ReportKind, file: Path | None, title: str, *, shows_all: bool) -> None:
        from . import document
        from .report import ComparisonReport

        contents = ComparisonReport(self.info, self.comparison, title, shows_all=shows_all)
        for_ci = {
            ReportKind.JUNIT: document.render_junit,
            ReportKind.GITHUB: document.render_annotations,
            ReportKind.BADGE: document.render_badge,
        }
        render = for_ci.get(report)
        _write(contents, report, file, render(self.info) if render else "")

    def end(self, *, strict: bool) -> int:
        from .gate import GateOutcome

        is_let_pass = self.outcome is GateOutcome.INCONCLUSIVE and not strict
        if self.info.gates or self.outcome is GateOutcome.NOTHING_TO_COMPARE:
            warning = ", which passes with this warning; --strict fails" if is_let_pass else ""
            say(f"dds-trace: {self.outcome.word}{warning}")
        return 0 if is_let_pass else self.outcome.exit_code


def judge_sides(
    base: "Path | Analysis",
    new: Path | None,
    gates: "Sequence[Gate]",
    *,
    looks: int = 1,
    allow_missing: bool = False,
    **options: Any,
) -> JudgedSides:
    from dds_trace.analyzer.pipeline import analyze
    from dds_trace.analyzer.statistics.power import confidence_at_each
    from dds_trace.base.units import counted

    from .compare import CompareOptions, compare
    from .gate import GateOutcome
    from .gates import judge_gates, options_for, overall_outcome
    from .info import comparison_info
    from .words import with_undecided

    before = analyze(base, details=False) if isinstance(base, Path) else base
    after = before if new is None else analyze(new, details=False)
    at_each = CompareOptions(confidence=confidence_at_each(looks), **options)
    comparison = compare(before, after, options_for(gates, at_each))
    results = judge_gates(comparison, gates, allow_missing=allow_missing)
    for folder, side in ((base, before), (new, after)):
        for finding in side.findings if isinstance(folder, Path) else ():
            if finding.code == "not_applied":
                say(f"{folder}: {finding.where}: {finding.what}")
    if comparison.delivery.is_empty():
        outcome = GateOutcome.NOTHING_TO_COMPARE
    else:
        outcome = overall_outcome(result.outcome for result in results) if results else GateOutcome.PASSED
    info = comparison_info(comparison, results)
    if new is None:
        said = f"{counted(len(info.groups), 'result')} against limits."
        info = replace(info, answer=with_undecided((said,), info.gates), seen="", groups=(), rules=())
    return JudgedSides(comparison, info, outcome)


def read_gates(
    texts: list[str], limits_file: Path | None, *, one_side: bool = False, needed: bool = False
) -> "list[Gate]":
    from .gate import parse_gates
    from .limits_file import limits_of_one_side, read_limits

    gates = parse_gates(texts)
    if one_side and (limits_of_one_side(gates) != gates or (needed and not gates and limits_file is None)):
        raise OptionError("without NEW give limits of one side, such as --fail-if 'latency_p99 > 20ms', or name NEW")
    more = [] if limits_file is None else read_limits(limits_file)
    more = limits_of_one_side(more) if one_side else more
    if limits_file is not None and not more:
        of_one = " of one side" if one_side else ""
        raise OptionError(f"{limits_file}: has no limit{of_one} for results; write one, or leave out --limits")
    return [*gates, *more]


def topic_limits(texts: list[str]) -> "list[Gate]":
    """Return the limits of `analyze`, of topics only; an `OptionError` for others."""
    from dds_trace.analyzer.model.metrics import METRICS

    from .gate import Against, parse_gates

    gates = parse_gates(texts)
    if any(gate.against is not Against.NEW or gate.metric in METRICS for gate in gates):
        raise OptionError(
            "--fail-if takes limits of topics here, such as 'age_p99(/camera/image) > 50ms'; limits of latency: "
            "dds-trace compare RUNS --fail-if 'latency_p99 > 20ms'"
        )
    return gates


def judge_topics(analysis: "Analysis", gates: "Sequence[Gate]") -> int:
    judged = judge_sides(analysis, None, gates)
    judged.write(ReportKind.TERMINAL, None, "", shows_all=False)
    return judged.end(strict=True)

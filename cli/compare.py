"""`dds-analyze compare BASE NEW`: two folders of traces against each other, as a table or as a gate for CI."""

import sys
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dds_trace.tracefile import limits
from dds_trace.tracefile.units.durations import format_ms

from .quick_help import command_app, declare_command

if TYPE_CHECKING:
    from dds_trace.analyzer import Comparison, GateOutcome, GateResult


class Unsure(str, Enum):
    """Exits of an inconclusive comparison."""

    PASS = "pass"  # noqa: S105 - no password: to let pass
    FAIL = "fail"


class ComparisonReport(str, Enum):
    """Kinds of report of a comparison."""

    TERMINAL = "terminal"
    MD = "md"
    JUNIT = "junit"


app = command_app()


@declare_command(app)
def compare_command(
    base: Annotated[Path, typer.Argument(metavar="BASE", help="Traces before.", show_default=False)],
    new: Annotated[Path, typer.Argument(metavar="NEW", help="Traces after.", show_default=False)],
    fail_if: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GATE",
            help="Such as 'latency_p99 > +10%', 'rtt_p50 > +2ms', 'latency_p99 > 20ms', 'received_ratio < 99%', "
            "'received_ratio < -0.5 points'; repeatable. 'default' is p50 > +10%, p99 > +20%, received < -0.5 points.",
            show_default=False,
        ),
    ] = None,
    allow_missing: Annotated[
        bool,
        typer.Option(
            "--allow-missing", help="A group may be missing on the new side, or lose every message there."
        ),
    ] = False,
    inconclusive: Annotated[
        Unsure, typer.Option(metavar="EXIT", help="pass: an inconclusive gate exits with 0; fail: with 21.")
    ] = Unsure.FAIL,
    paired: Annotated[
        bool,
        typer.Option(
            "--paired", help="Both sides were measured in the same passes of one sweep: compare pass by pass."
        ),
    ] = False,
    report: Annotated[
        ComparisonReport, typer.Option(metavar="KIND", help="terminal, md or junit.")
    ] = ComparisonReport.TERMINAL,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Where the report goes.  [dim]Default: stdout[/dim]", show_default=False
        ),
    ] = None,
) -> None:
    """Compare two sets of traces: per group the change of each percentile, how sure it is, and a verdict.

    The run is the unit: with fewer than three runs a side nothing is called better or worse. A gate fails only where
    the whole confidence interval lies beyond its limit, or where a group of the base is missing or dead on the new
    side. Exit codes: 0 passed, or no gate given; 20 regressed; 21 inconclusive (too few runs or messages to tell); 22
    nothing to compare (no group in common).

    [bold]dds-analyze compare main/ branch/ --fail-if "latency_p99 > +10%" --report md[/bold]
    """
    from dds_trace.analyzer import (
        CompareOptions,
        GateOutcome,
        analyze,
        compare,
        judge_gates,
        options_for,
        overall_outcome,
        parse_gates,
    )

    for path, where, limit in (
        (base, "BASE", limits.INPUT),
        (new, "NEW", limits.INPUT),
        (out, "--out", limits.PATH),
    ):
        limits.check(limit, None if path is None else str(path), where)
    gates = parse_gates(fail_if or [])  # before anything is read
    before, after = (analyze(folder, details=False) for folder in (base, new))
    comparison = compare(before, after, options_for(gates, CompareOptions(paired=paired)))
    results = judge_gates(comparison, gates, allow_missing=allow_missing)
    for folder, side in ((base, before), (new, after)):
        for finding in side.findings:
            if finding.code == "not_applied":
                print(f"{folder}: {finding.where}: {finding.what}", file=sys.stderr)
    if comparison.delivery.is_empty():
        outcome = GateOutcome.NOTHING_TO_COMPARE
    else:
        outcome = overall_outcome(results) if results else GateOutcome.PASSED
    if report is ComparisonReport.TERMINAL and out is None:
        _print_table(comparison, results)
    else:
        _print_or_write(_text(report, comparison, results), out)
    _print_outcome(outcome, gated=bool(results))
    is_let_pass = outcome is GateOutcome.INCONCLUSIVE and inconclusive is Unsure.PASS
    raise typer.Exit(0 if is_let_pass else outcome.exit_code)


def _text(report: ComparisonReport, comparison: "Comparison", results: "list[GateResult]") -> str:
    from dds_trace.reports.comparison import comparison_junit, comparison_markdown

    if report is ComparisonReport.JUNIT:
        return comparison_junit(results)
    return comparison_markdown(comparison, results)


def _print_or_write(text: str, out: Path | None) -> None:
    """Print a report, or write it to `out`.

    Raises:
        OutputError: it cannot be written.
    """
    from dds_trace.tracefile import OutputError
    from dds_trace.tracefile.files import replacing

    if out is None:
        sys.stdout.write(text)
        return
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with replacing(out) as draft:
            draft.write_text(text, encoding="utf-8")
    except OSError as err:
        raise OutputError(f"{out}: cannot be written ({err.strerror or err}); give another --out") from err
    print(f"Wrote {out}")


def _print_table(comparison: "Comparison", results: "list[GateResult]") -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from dds_trace.analyzer import group_words, varying_columns
    from dds_trace.reports.changes import episodes_words, received_words, runs_words
    from dds_trace.reports.comparison import (
        comparison_notes,
        comparison_sentence,
        environments_of_rows,
        family_words,
        result_line,
    )
    from dds_trace.tracefile.visible import MAX_FINDING_CHARACTERS, visible

    console = Console(width=None if sys.stdout.isatty() else 200)
    first = visible(comparison_sentence(comparison), MAX_FINDING_CHARACTERS)
    console.print(Text(first, style="bold"), soft_wrap=True)
    environments = environments_of_rows(comparison)
    table = Table(
        "group",
        "metric",
        "base ms",
        "new ms",
        "tail rests on",
        "received",
        "change",
        "interval",
        "runs",
        "found from",
        "verdict",
        *(["environment"] if environments else []),
    )
    names = varying_columns(comparison)
    for number, row in enumerate(comparison.rows.iter_rows(named=True)):
        low, high = _percent(row["ratio_low"]), _percent(row["ratio_high"])
        cells = (
            visible(group_words(row, names), MAX_FINDING_CHARACTERS),
            f"{row['metric']} {row['statistic']}",
            _with_survivors(row["base_ns"], row["base_survivors_ns"]),
            _with_survivors(row["new_ns"], row["new_survivors_ns"]),
            " -> ".join(filter(None, (episodes_words(row, side) for side in ("base", "new")))),
            received_words(row),
            _percent(row["ratio"]),
            f"{low} to {high}" if low and high else "unknown",
            runs_words(row),
            _percent(row["smallest_ratio"]),
            row["verdict"],
            *(visible(name, MAX_FINDING_CHARACTERS) for name in environments[number : number + 1]),
        )
        table.add_row(*map(Text, cells))
    console.print(table)
    console.print(Text(family_words(gated=bool(results))), soft_wrap=True)
    for line in [*comparison_notes(comparison), *map(result_line, results)]:
        console.print(Text(line), soft_wrap=True)


def _with_survivors(value_ns: float | None, survivors_ns: float | None) -> str:
    """Write a time, and beside a lost one that of the survivors."""
    if value_ns is None or value_ns != float("inf"):
        return _ms(value_ns)
    return "lost" if survivors_ns is None else f"lost (survivors {_ms(survivors_ns)})"


def _ms(value_ns: float | None) -> str:
    return "" if value_ns is None else format_ms(value_ns)


def _percent(ratio: float | None) -> str:
    if ratio is None:
        return ""
    return "lost" if ratio == float("inf") else f"{ratio - 1:+.1%}"


def _print_outcome(outcome: "GateOutcome", *, gated: bool) -> None:
    """Print the outcome to stderr; without a gate, only that there is nothing to compare."""
    from dds_trace.analyzer import GateOutcome

    if gated or outcome is GateOutcome.NOTHING_TO_COMPARE:
        print(f"dds-analyze compare: {outcome.value}", file=sys.stderr)

"""`dds-analyze compare BASE NEW`: two folders of traces against each other, as a table or as a gate for CI."""

import sys
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dds_trace.tracefile.units.durations import format_ms

if TYPE_CHECKING:
    from dds_trace.analyzer import Comparison, GateOutcome, GateResult


class ComparisonReport(str, Enum):
    """Kinds of report of a comparison."""

    TERMINAL = "terminal"
    MD = "md"
    JUNIT = "junit"


app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode="rich")


@app.command(context_settings={"help_option_names": ["-h", "--help"]})
def compare_command(
    base: Annotated[Path, typer.Argument(metavar="BASE", help="Traces before.", show_default=False)],
    new: Annotated[Path, typer.Argument(metavar="NEW", help="Traces after.", show_default=False)],
    fail_if: Annotated[
        list[str] | None,
        typer.Option(
            metavar="GATE",
            help="Such as 'latency_p99 > +10%', 'rtt_p50 > +2ms', 'latency_p99 > 20ms', 'received_ratio < 99%'; "
            "repeatable.",
            show_default=False,
        ),
    ] = None,
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

    A gate fails only where the whole confidence interval lies beyond its limit. Exit codes: 0 passed, or no gate
    given; 20 regressed; 21 inconclusive (too few messages to tell); 22 nothing to compare (no group in common).

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
        parse_gate,
    )

    gates = [parse_gate(text) for text in fail_if or []]  # before anything is read
    before, after = (analyze(folder, details=False) for folder in (base, new))
    comparison = compare(before, after, options_for(gates, CompareOptions()))
    results = judge_gates(comparison, gates)
    for folder, side in ((base, before), (new, after)):
        for finding in side.findings:
            if finding.code == "not_applied":
                print(f"{folder}: {finding.where}: {finding.what}", file=sys.stderr)
    if comparison.delivery.is_empty():
        outcome = GateOutcome.NOTHING_TO_COMPARE
    else:
        outcome = overall_outcome(results) if gates else GateOutcome.PASSED
    if report is ComparisonReport.TERMINAL and out is None:
        _print_table(comparison, results)
    else:
        _print_or_write(_text(report, comparison, results), out)
    _print_outcome(outcome, gated=bool(gates))
    raise typer.Exit(outcome.exit_code)


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

    if out is None:
        sys.stdout.write(text)
        return
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(text, encoding="utf-8")
    except OSError as err:
        raise OutputError(f"{out}: cannot be written ({err.strerror or err}); give another --out") from err
    print(f"Wrote {out}")


def _print_table(comparison: "Comparison", results: "list[GateResult]") -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from dds_trace.analyzer import group_words, varying_columns
    from dds_trace.tracefile.visible import MAX_FINDING_CHARACTERS, visible

    console = Console(width=None if sys.stdout.isatty() else 160)
    table = Table("group", "metric", "base ms", "new ms", "change", "interval", "verdict")
    names = varying_columns(comparison)
    for row in comparison.rows.iter_rows(named=True):
        low, high = _percent(row["ratio_low"]), _percent(row["ratio_high"])
        cells = (
            visible(group_words(row, names), MAX_FINDING_CHARACTERS),
            f"{row['metric']} {row['statistic']}",
            _ms(row["base_ns"]),
            _ms(row["new_ns"]),
            _percent(row["ratio"]),
            f"{low} to {high}" if low and high else "unknown",
            row["verdict"],
        )
        table.add_row(*map(Text, cells))
    console.print(table)
    for result in results:
        console.print(
            Text(
                f"{result.outcome.value}: {result.gate.text} ({visible(result.where, MAX_FINDING_CHARACTERS)})"
            )
        )


def _ms(value_ns: float | None) -> str:
    return "" if value_ns is None else format_ms(value_ns)


def _percent(ratio: float | None) -> str:
    return "" if ratio is None else f"{ratio - 1:+.1%}"


def _print_outcome(outcome: "GateOutcome", *, gated: bool) -> None:
    """Print the outcome to stderr; without a gate, only that there is nothing to compare."""
    from dds_trace.analyzer import GateOutcome

    if gated or outcome is GateOutcome.NOTHING_TO_COMPARE:
        print(f"dds-analyze compare: {outcome.value}", file=sys.stderr)

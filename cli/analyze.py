"""`dds-trace analyze runs/`: a folder of traces becomes tables, reports and Parquet files."""

from __future__ import annotations

from typing import Annotated

import typer

from dds_trace.analyzer.exports.kinds import EXPORT_KINDS
from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.extension import load
from dds_trace.base.units import parse_duration

from .outputs import FIGURE_WIDTHS_MM, Opens, Out, Paths, Reports, ShowsAll, kinds_of
from .program import Version, command, make_app, option

app = make_app(completes=True)


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
    figures: Annotated[
        list[str] | None, kinds_of(FIGURE_WIDTHS_MM, "--figures KIND", "Figures for a paper, 174 or 84 mm wide")
    ] = None,
    fail_if: Annotated[
        list[str] | None,
        option(
            "--fail-if LIMIT",
            "Fail if a topic that taps heard is beyond this limit: 'age_p99(/camera) > 50ms'; repeatable.",
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
    from .analysis import run_analysis

    limits.check(limits.SCHEDULER, cluster, "--cluster")
    deadline_ns, deadline_metric = _parse_deadline(deadline)
    gates = load("parts", "topic_limits")(fail_if) if fail_if else ()
    more = {
        "cluster": cluster,
        "sketch": sketch,
        "deadline_ns": deadline_ns,
        "deadline_metric": deadline_metric,
        "margin": 0.05 if margin is None else _parse_margin(margin),
        "trust_order": trust_order,
    }
    analysis = run_analysis(
        paths,
        out,
        report,
        more,
        exports=export,
        derived_mcap=derived_mcap,
        figures=figures,
        open_it=open_it,
        shows_all=shows_all,
    )
    if gates:
        raise typer.Exit(load("parts", "judge_topics")(analysis, gates))


def _parse_margin(text: str) -> float:
    from dds_trace.recorder.option import parse_percentage

    return parse_percentage("--margin", text)


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

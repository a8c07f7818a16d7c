"""The frozen `Analysis` of a folder of traces: what the analyzer returns."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl
from polars.exceptions import PolarsError

from dds_trace.base.errors import TraceFormatError
from dds_trace.base.extension import load
from dds_trace.base.printable import printable
from dds_trace.base.records import to_json
from dds_trace.base.units import counted
from dds_trace.tracefile.format.descriptions import Run, Session

from .model.columns import SUMMARY_COLUMNS
from .model.detail_frames import HOP_SCHEMA, TOPIC_MESSAGE_SCHEMA, TOPIC_SCHEMA
from .model.finding import UNUSABLE, Finding, Source
from .model.metrics import schema_of
from .model.runs import with_unsent
from .pairing.rows import RowStore
from .verdicts.answers import CaseAnswer
from .verdicts.frame import judge_own_nodes, judge_places, judged_candidates, judged_costs
from .verdicts.judgements import judgement_frame

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from .verdicts.recommend import Recommendation


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Details:
    """Results that take longer than rows and summary. `group` is the row number in `summary`; times in ns.

    Attributes:
        intervals: percentiles with their confidence intervals (`intervals.INTERVAL_SCHEMA`).
        one_way: way out and way back (`intervals.ONE_WAY_SCHEMA`); asymmetry of the link within the bound is invisible.
        breakdown: where the time goes, a row per part (`breakdown.BREAKDOWN_SCHEMA`).
        responses: response time against round trip time (`breakdown.RESPONSE_SCHEMA`).
        freshness: deadlines and age of information by run and relay (`freshness.FRESHNESS_SCHEMA`).
        outages: `freshness.OUTAGE_SCHEMA`.
        clock_fits: by pair of devices, boot and stretch without a step (`one_way.SEGMENT_SCHEMA`).
        clock_knots: offsets to which the clocks are fitted (`one_way.KNOT_SCHEMA`).
        host_samples: load of the devices over time (`host_samples.HOST_SAMPLE_SCHEMA`).
        bridge_costs: different domains against the same domain (`bridge_cost.bridge_cost`).
        interference: flows with others, and results under a load, against each without (`interference.INTERFERENCE_SCHEMA`).
        head_of_line: whether messages of a flow wait for another's (`interference.HEAD_OF_LINE_SCHEMA`).
        recoveries: runs with an outage that the sweep made (`detail_frames.RECOVERY_SCHEMA`).
        fan_out: one message to several relays, and several pings (`detail_frames.FAN_OUT_SCHEMA`).
        fan_out_positions: the same by relay (`detail_frames.FAN_OUT_POSITION_SCHEMA`).
        wire: cost on the wire by group recorded with `--wire` (`groups.wire`).
        wire_classes: the same by class of traffic.
        wire_repeats: the same by number of repeats.
        answers: the fastest setups for each message.
        deadline_ns: the deadline of `freshness`.
        deadline_metric: its metric.
        recommendation: settings for the `job` of the analysis.
        requested: False for an analysis with `details=False`: its frames are empty.
    """

    intervals: pl.DataFrame
    one_way: pl.DataFrame
    breakdown: pl.DataFrame
    responses: pl.DataFrame
    freshness: pl.DataFrame
    outages: pl.DataFrame
    clock_fits: pl.DataFrame
    clock_knots: pl.DataFrame
    host_samples: pl.DataFrame
    bridge_costs: pl.DataFrame
    interference: pl.DataFrame
    head_of_line: pl.DataFrame
    recoveries: pl.DataFrame
    fan_out: pl.DataFrame
    fan_out_positions: pl.DataFrame
    wire: pl.DataFrame
    wire_classes: pl.DataFrame
    wire_repeats: pl.DataFrame
    answers: tuple[CaseAnswer, ...]
    deadline_ns: int | None = None
    recommendation: Recommendation | None = None
    requested: bool = True
    deadline_metric: str = "response"

    def __repr__(self) -> str:
        frames = (f"{name}: {counted(len(getattr(self, name)), 'row')}" for name in DETAIL_FRAMES)
        return f"<Details: {', '.join(frames)}; answers: {len(self.answers)}>"


@dataclass(frozen=True, eq=False, repr=False)
class Analysis:
    """Everything that was computed from one folder of traces.

    Attributes:
        sessions: the recording processes, by start.
        runs: by start.
        rows: the round trips; read with `load_roundtrips` and `scan_roundtrips`.
        summary: one row per group (`docs/trace-format.md`); row i is group i of all frames with a column `group`.
        distributions: `group` u32, `metric` str, `value_ns` f64 (bucket centre), `count` u64, relative error at most 0.1 %.
        run_times: when each run of each group sent, and what came back (`timeline.RUN_SCHEMA`).
        timeline: round trips to draw (`timeline.timeline_frame`).
        timeline_decimated: whether `timeline` leaves rows out.
        outputs: files written, by kind (`roundtrips`, `summary`).
        unsent: run_id -> messages that were due and never left.
        topics: topics that taps heard, a row for each topic and pair of devices (`detail_frames.TOPIC_SCHEMA`).
        topic_messages: their messages, with the columns of the round trips and more (`detail_frames.TOPIC_MESSAGE_SCHEMA`).
        topic_hops: what each hop of a chain of topics takes (`detail_frames.HOP_SCHEMA`).
    """

    title: str
    sources: tuple[Source, ...]
    sessions: tuple[Session, ...]
    runs: tuple[Run, ...]
    rows: RowStore
    summary: pl.DataFrame
    distributions: pl.DataFrame
    run_times: pl.DataFrame
    timeline: pl.DataFrame
    timeline_decimated: bool
    findings: tuple[Finding, ...]
    details: Details
    outputs: Mapping[str, Path] = field(default_factory=dict)
    unsent: Mapping[int, int] = field(default_factory=dict)
    topics: pl.DataFrame = field(default_factory=lambda: pl.DataFrame(schema=TOPIC_SCHEMA))
    topic_messages: pl.DataFrame = field(default_factory=lambda: pl.DataFrame(schema=TOPIC_MESSAGE_SCHEMA))
    topic_hops: pl.DataFrame = field(default_factory=lambda: pl.DataFrame(schema=HOP_SCHEMA))

    def __repr__(self) -> str:
        counts = (
            counted(len(self.sources), "file"),
            counted(len(self.runs), "run"),
            counted(len(self.summary), "result"),
            counted(len(self.findings), "finding"),
        )
        return f"<Analysis of {printable(self.title, _MOST_TITLE)}: {', '.join(counts)}; .summary, .findings, .show()>"

    def load_roundtrips(self) -> pl.DataFrame:
        """Read all round trips into memory, gigabytes of a large campaign: by group, run, relay and sequence."""
        return self.rows.load()

    def load_messages(self) -> pl.DataFrame:
        """Read the round trips, the unsent messages (`runs.with_unsent`) and the messages of topics into memory."""
        messages = with_unsent(self.load_roundtrips(), self.unsent)
        if self.topic_messages.is_empty():
            return messages
        return pl.concat([messages.cast({"outcome": pl.String}), self.topic_messages], how="diagonal")

    @property
    def barred_groups(self) -> pl.DataFrame:
        """The rows of `summary` in which a requested setting was not applied (finding `not_applied`)."""
        barred = {group for finding in self.findings if finding.code == "not_applied" for group in finding.groups}
        return self.summary[sorted(barred)]

    @property
    def unusable_groups(self) -> frozenset[int]:
        """Rows of `summary` that are in no answer: their replies are not their relay's, or not of the messages' size."""
        return frozenset(group for finding in self.findings if finding.code in UNUSABLE for group in finding.groups)

    @cached_property
    def judgements(self) -> pl.DataFrame:
        """What is said of setups, links, devices, bridges, flows and a job, a row each (`judgements.JUDGEMENT_SCHEMA`); empty without details."""
        details = self.details
        rows = [
            *(replace(row, subject=f"{row.subject}; {a.words}") for a in details.answers for row in a.judgements),
            *judge_own_nodes(details.answers, self.summary),
            *judge_places(self.summary, details.intervals, self.unusable_groups),
            *judged_costs(details.bridge_costs, details.interference),
            *(judged_candidates(details.recommendation) if details.recommendation else ()),
        ]
        return judgement_frame(rows)

    def scan_roundtrips(self) -> pl.LazyFrame:
        """Return the round trips as a lazy frame, which reads only what a query needs."""
        return self.rows.scan()

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write the analysis into a folder of its own, for `load_analysis`; an earlier one there is replaced as a whole.

        Raises:
            OutputExistsError: the folder has something else than a saved analysis.
            OutputError: the folder cannot be written.
        """
        from .saving.folder import write_folder
        from .saving.records import Content

        content = Content(
            title=self.title,
            sources=self.sources,
            sessions=tuple(session.to_json() for session in self.sessions),
            runs=tuple(run.to_json() for run in self.runs),
            timeline_decimated=self.timeline_decimated,
            findings=self.findings,
            outputs={kind: str(path) for kind, path in self.outputs.items()},
            unsent={f"{run_id:016x}": count for run_id, count in self.unsent.items()},
            **{name: getattr(self.details, name) for name in _DETAIL_VALUES},
        )
        text = json.dumps(to_json(content), allow_nan=False)
        frames = {name: getattr(self, name) for name in _FRAMES}
        frames |= {name: getattr(self.details, name) for name in DETAIL_FRAMES}
        write_folder(
            Path(folder),
            {
                _CONTENT: lambda path: path.write_text(text, encoding="utf-8"),
                _ROUNDTRIPS: self.scan_roundtrips().sink_parquet,
                **{f"{name}.parquet": frame.write_parquet for name, frame in frames.items()},
            },
        )

    def _repr_html_(self) -> str:
        screen: str = load("parts", "presenter").first_screen(self)
        return screen

    def plot(
        self, name: str, *, panels: str | None = None, metric: str | None = None, statistic: str = "p50"
    ) -> Figure:
        """Return a figure of the report as a plotly `Figure`.

        Args:
            name: `latency_by_size`, `latency_by_rate`, `vendor_comparison`, `by_device`, `relay_time`, `received`, `run_spread`,
                `sustainable`, `transfer_by_size`, `transfer_by_rate` or `transfer_rate`.
            panels: dimension of the panels: `size`, `rate`, `device`, `link`, `middleware` or `bridge`; None as in the report.
            metric: `latency`, `rtt`, `intermediate` or `response`; None for the report's. For figures of times.
            statistic: `mean`, `min`, `max` or a percentile such as `p99_9`. For figures of times and their spread.

        Raises:
            OptionError: there is no such figure, dimension, metric or statistic, or nothing to draw.
        """
        return load("parts", "presenter").plot(self, name, panels=panels, metric=metric, statistic=statistic)

    def show(self, folder: str | os.PathLike[str] | None = None) -> Path:
        """Write the HTML report, open it in a browser and return its path.

        Without a `folder` it is in a new temporary one, which is not removed.

        Raises:
            OutputError: the report cannot be written.
        """
        path: Path = load("parts", "presenter").show(self, None if folder is None else Path(folder))
        return path


_MOST_TITLE = 200
_CONTENT, _ROUNDTRIPS = "content.json", "roundtrips.parquet"
_TOPIC_FRAMES = frozenset({"topics", "topic_messages", "topic_hops"})
"""Frames that earlier saves lack."""
_FRAMES, DETAIL_FRAMES = (
    tuple(field.name for field in fields(kind) if field.type == "pl.DataFrame") for kind in (Analysis, Details)
)
_DETAIL_VALUES = tuple(field.name for field in fields(Details) if field.name not in DETAIL_FRAMES)


def load_analysis(folder: str | os.PathLike[str]) -> Analysis:
    """Read an analysis that `Analysis.save` wrote; its round trips are read on demand.

    Raises:
        TraceFormatError: there is no saved analysis of this version, or a file of it was changed.
    """
    from .saving.folder import read_folder
    from .saving.records import Content, from_json

    files = read_folder(Path(folder))
    try:
        content = from_json(Content, json.loads(files[_CONTENT].read_bytes()))
        names = [name for name in (*_FRAMES, *DETAIL_FRAMES) if name not in _TOPIC_FRAMES or f"{name}.parquet" in files]
        frames = {name: pl.read_parquet(files[f"{name}.parquet"]) for name in names}
        rows = RowStore.of(files[_ROUNDTRIPS], frames["summary"])
    except (KeyError, ValueError, RecursionError, OSError, PolarsError) as err:
        raise TraceFormatError(
            Path(folder), f"the saved analysis cannot be read ({err}); analyze the traces again"
        ) from err
    if missing := [name for name in schema_of(SUMMARY_COLUMNS) if name not in frames["summary"].columns]:
        what = f"it lacks the columns {', '.join(missing)} of summary; analyze the traces again"
        raise TraceFormatError(files["summary.parquet"], what)
    where = files[_CONTENT]
    return Analysis(
        title=content.title,
        sources=content.sources,
        sessions=tuple(Session.from_json(text, where) for text in content.sessions),
        runs=tuple(Run.from_json(text, where) for text in content.runs),
        rows=rows,
        **{name: frames[name] for name in _FRAMES if name in frames},
        timeline_decimated=content.timeline_decimated,
        findings=content.findings,
        details=Details(
            **{name: getattr(content, name) for name in _DETAIL_VALUES} | {n: frames[n] for n in DETAIL_FRAMES}
        ),
        outputs={kind: Path(path) for kind, path in content.outputs.items()},
        unsent={int(run_id, 16): count for run_id, count in content.unsent.items()},
    )

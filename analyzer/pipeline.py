"""From a folder of traces to one `Analysis`: load, find exchanges, group, process batches, merge, judge, check."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import polars as pl

from dds_trace.base.errors import OutputError
from dds_trace.base.extension import load
from dds_trace.base.files import real_path

from .analysis import Analysis
from .details import collect_details, details_not_requested
from .engines.batches import BatchOutput, BatchResult, groups_in_parts, plan_batches
from .engines.local import Engine
from .engines.merge import merge_results
from .findings.evidence import Evidence
from .findings.runs import forged_groups
from .findings.table import find_findings
from .groups.batch import DEADLINE_METRIC, AnalysisOptions, group_exchanges
from .groups.shapes import SHAPE_SCHEMA
from .loading.campaign import Campaign, Progress
from .loading.event_index import total_copies
from .loading.place import Paths, Place
from .loading.traces import TraceSpool
from .model.detail_frames import Topics
from .pairing.exchanges import find_exchanges
from .pairing.parquet import provenance, write_summary
from .pairing.rows import RowWriter
from .saving.results import replacing_results
from .verdicts.cases import UnbarredRows
from .verdicts.job import Job
from .verdicts.ranking import RankingOptions

Step = Callable[[str, float], None]


PAIRING, JUDGING, WRITING = STEPS = ("pairing", "judging", "writing")
"""What follows the reading of the traces; a caller that writes reports calls the last."""


def analyze(
    path: Paths,
    *,
    out: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    step: Step | None = None,
    cluster: str | None = None,
    sketch: bool = False,
    details: bool = True,
    deadline_ns: int | None = None,
    deadline_metric: str = DEADLINE_METRIC,
    job: Job | None = None,
    margin: float = 0.05,
    trust_order: bool = False,
    write_more: Callable[[Analysis, Path], object] | None = None,
    spool: TraceSpool | None = None,
) -> Analysis:
    """Analyze every trace in a folder.

        from dds_trace import analyze
        a = analyze("runs/")
        a.summary.select("vendor", "payload_bytes", "latency_p50_ns", "latency_p99_ns")

    From 2,000 traces on, worker processes do most of it; a script needs no `if __name__ == "__main__"` for them.

    Args:
        path: a folder (with all folders in it), one trace file, or one rosbag2 folder; or a list of such.
        out: folder for `roundtrips.parquet` and `summary.parquet`; None writes nothing. Traces in it are not read. Earlier
            files are replaced together.
        cluster: address of a Dask scheduler (`tcp://host:8786`); its workers read the traces, so `path` must be the same for
            them, or in object storage (`s3://...`).
        sketch: percentiles from histograms, off by at most `percentiles.RELATIVE_ERROR`, no rows and no comparison of groups.
        details: one-way times, `Analysis.details` and their findings; without, a large campaign takes a fraction of the time.
        deadline_ns: judge every message against it (`Analysis.details.freshness`).
        deadline_metric: `response`, `latency`, `rtt`, `outbound`...
        job: what to recommend settings for (`Analysis.details.recommendation`).
        margin: the least lead of a setup that is called fastest; 0.05 means that the next takes 5 % longer.
        trust_order: compare setups that were recorded one after the other, too.
        write_more: writes further files into the folder of drafts, to be replaced with the tables.
        spool: keeps loaded traces between analyses of a growing folder.
        progress: called before each trace is read: number done, number of all, path.
        step: called after the reading, with one of `STEPS` and the share of it that is done.

    Raises:
        MissingEventsError: there is no trace, or no published message in any.
        TraceFormatError: `path` is one file, and it is not a trace.
        OutputError: the results cannot be written, or `out` is the default folder and a symbolic link.
    """
    location, target = Place.of(path), Path(out) if out is not None else None
    if target is not None and target in location.own_folders and target.is_symlink():
        # The author of the traces chose where it leads, not the user who analyzes them.
        raise OutputError(f"{target} is a link to {target.readlink()}; give that folder, or another, with --out")
    options = AnalysisOptions(
        rows=not sketch,
        details=details,
        deadline_ns=deadline_ns,
        deadline_metric=deadline_metric,
        job=job,
        ranking=RankingOptions(margin, trust_order),
    )
    engine: Engine = Engine(spool) if cluster is None else load("parts", "cluster")(cluster)
    with ExitStack() as stack:
        with engine:
            campaign = engine.load(location, location.own_folders | ({target} if target else set()), progress)
            drafts = stack.enter_context(replacing_results(target)) if target else None
            analysis = _analyze(engine, campaign, location, target, drafts, options, step or (lambda *_: None))
        if drafts is not None and write_more is not None:
            write_more(analysis, drafts)
    if "roundtrips" in analysis.outputs:
        analysis.rows.moved_to(analysis.outputs["roundtrips"])
    return analysis


def _analyze(
    engine: Engine,
    campaign: Campaign,
    location: Place,
    out: Path | None,
    drafts: Path | None,
    options: AnalysisOptions,
    step: Step,
) -> Analysis:
    outputs = {kind: out / f"{kind}.parquet" for kind in ("roundtrips", "summary")} if out else {}
    stale_rows = None if options.rows else outputs.pop("roundtrips", None)
    drafted = {kind: drafts / path.name for kind, path in outputs.items()} if drafts else {}
    exchanges = find_exchanges(campaign)
    grouping = group_exchanges(exchanges.placed)
    batches = plan_batches(grouping, options)
    origin = provenance(campaign, exchanges)
    with RowWriter(drafted.get("roundtrips"), origin) as writer:
        results = _write_rows(
            engine.process(batches, campaign.events),
            writer,
            lambda batches_done: step(PAIRING, batches_done / len(batches)),
        )
        merged = merge_results(results, grouping, sketch=not options.rows)
    step(JUDGING, 0.0)
    rows = writer.store()
    rows.locate(merged.summary.frame)
    has_taps = any(session.role == "tap" for session in campaign.sessions.values())
    topics: Topics = load("parts", "topics")(campaign, rows) if has_taps else Topics.none()
    campaign = campaign.with_copies(total_copies([*exchanges.copies, *merged.copies]))
    in_parts = groups_in_parts(batches)
    unsent = merged.summary.unsent_by_run(grouping)
    evidence_with = partial(
        Evidence,
        campaign=campaign,
        exchanges=exchanges,
        grouping=grouping,
        summary=merged.summary,
        rows=rows,
        in_parts=tuple(in_parts),
        options=options,
        stale_rows=stale_rows if stale_rows and stale_rows.exists() else None,
        topics=topics,
        sending=merged.frames["sending"],
        shapes=merged.frames.get("shapes", pl.DataFrame(schema=SHAPE_SCHEMA)),
    )
    forged = forged_groups(
        merged.summary,
        merged.frames["clock_knots"] if options.details else None,
        lambda: evidence_with(details=details_not_requested()),
    )
    judged = UnbarredRows(rows, (*grouping.not_applied(), *forged), unsent)
    details = collect_details(campaign, grouping, merged.frames, rows, in_parts, options, judged)
    if drafts is not None:
        write_summary(merged.summary.frame, drafted["summary"], origin)
    timeline = merged.frames["timeline"]
    return Analysis(
        title=real_path(location.folder).name,
        sources=campaign.sources,
        sessions=tuple(sorted(campaign.sessions.values(), key=lambda s: (s.wall_anchor_ns, s.session_id))),
        # Runs with messages in the order of their rows, then runs without.
        runs=tuple({**{exchange.run.run_id: exchange.run for exchange in exchanges.placed}, **campaign.runs}.values()),
        rows=rows,
        summary=merged.summary.frame,
        distributions=merged.summary.distributions,
        run_times=merged.frames["run_times"],
        timeline=timeline,
        timeline_decimated=timeline.height < merged.summary.frame["published"].sum(),
        findings=find_findings(evidence_with(details=details)),
        outputs=outputs,
        details=details,
        unsent=unsent,
        topics=topics.topics,
        topic_messages=topics.topic_messages,
        topic_hops=topics.topic_hops,
    )


def _write_rows(
    outputs: Iterable[BatchOutput], writer: RowWriter, advance: Callable[[int], None]
) -> Iterator[BatchResult]:
    for number, output in enumerate(outputs):
        advance(number)
        writer.write(output.tables())
        result = output.result
        del output  # its rows are written
        yield result

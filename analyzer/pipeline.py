"""From a folder of traces to one `Analysis`, step by step."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from dds_trace.tracefile import MissingEventsError
from dds_trace.tracefile.units.counts import counted

from .analysis import Analysis
from .details import collect_details
from .engines.batches import Work, plan_batches
from .engines.cluster import ClusterEngine
from .engines.local import LocalEngine
from .engines.merge import MergedResults
from .findings.evidence import Evidence
from .findings.left_out import SKETCHED, earlier_rows, size_findings
from .findings.table import find_findings
from .groups.batch import Wanted
from .groups.summary import group_exchanges
from .loading.remote import is_remote
from .pairing.exchanges import find_exchanges
from .pairing.parquet import write_summary
from .pairing.rows import RowKeeper, RowsByGroup

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator

    from dds_trace.tracefile import Run

    from .engines.local import Engine
    from .groups.summary import Grouping
    from .loading.campaign import Campaign, Progress
    from .pairing.exchanges import Exchanges
    from .verdicts.job import Job

OUTPUT_FOLDER = "analysis"
"""Where results go by default, below the analyzed folder."""

CACHE_FOLDER = "cache"
"""Where events are kept for the next analysis, below the folder for the results."""


def default_output(path: Path) -> Path:
    """The folder for the results of `path`: `analysis/` in it, beside it if it is itself a trace, here if it is remote."""
    if is_remote(path):
        return Path(OUTPUT_FOLDER)
    is_trace = path.is_file() or (path / "metadata.yaml").is_file()
    return (path.parent if is_trace else path) / OUTPUT_FOLDER


def analyze(
    path: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    cache: bool = False,
    cluster: str | None = None,
    sketch: bool = False,
    details: bool = True,
    deadline_ns: int | None = None,
    job: Job | None = None,
) -> Analysis:
    """Analyze every trace in a folder.

        from . import analyze
        a = analyze("runs/")
        a.summary.select("vendor", "payload_bytes", "latency_p50_ns", "latency_p99_ns")

    Args:
        path: a folder (looked through to its depths), one trace file, or one rosbag2 folder.
        out: folder for `roundtrips.parquet` and `summary.parquet`; None writes nothing. It is never looked
            into for traces, nor is `analysis/` in `path`.
        cache: keep the events of every trace below `out`, so that the next analysis with the same `out` reads
            only traces that are new; a third to a half of the bytes that they take in memory.
        cluster: address of a Dask scheduler (`tcp://host:8786`) whose workers do the work; they read the traces
            themselves, so `path` must be the same for them, or in object storage (`s3://...`). Keeps no cache.
        sketch: percentiles from histograms, off by `histogram.RELATIVE_ERROR` at most, and no rows: neither
            `roundtrips` nor its file, and no group compared with another. So no rows travel, and a group may be of
            any size. Rows that an earlier analysis left in `out` stay there, and a finding says so.
        details: one-way times, `Analysis.details` and the findings that rest on them; without, these are null, empty
            and absent, and a large campaign takes a fraction of the time.
        deadline_ns: judge every message against it (`Analysis.details.freshness`).
        job: what to recommend settings for (`Analysis.details.recommendation`).
        progress: called before each trace is read with the number done, the number of all, and its path.

    Raises:
        MissingEventsError: there is no trace, or no published message in any.
        TraceFormatError: `path` is one file, and it is no trace.
        OutputError: the results cannot be written.
    """
    folder, target = Path(path), Path(out) if out is not None else None
    engine: Engine
    if cluster is not None:
        engine = ClusterEngine(cluster)
    else:
        engine = LocalEngine(target / CACHE_FOLDER if target and cache else None)
    try:
        wanted = Wanted(details, deadline_ns, job)
        return _analyze(folder, target, engine, progress, wanted, sketch=sketch)
    finally:
        engine.close()


def _analyze(
    folder: Path,
    out: Path | None,
    engine: Engine,
    progress: Progress | None,
    wanted: Wanted,
    *,
    sketch: bool,
) -> Analysis:
    own = {default_output(folder)} | ({out} if out is not None else set())
    campaign = engine.load(folder, own, progress)
    exchanges = find_exchanges(campaign)
    if not exchanges.held:
        raise MissingEventsError(_nothing_to_pair(campaign, exchanges))

    grouping = group_exchanges(exchanges.held)
    outputs = {kind: out / f"{kind}.parquet" for kind in ("roundtrips", "summary")} if out else {}
    remarks = [SKETCHED] if sketch else []
    if sketch and outputs and (written := outputs.pop("roundtrips")).exists():
        remarks.append(earlier_rows(written))
    merged = MergedResults(sketch=sketch)
    batches = list(_batches(grouping, wanted, with_rows=not sketch))
    with RowKeeper(outputs.get("roundtrips")) as keeper:
        for worked in engine.work(batches, campaign.events):
            if worked.table is not None:
                keeper.add(worked.table)
            merged.add(worked)
    paired, frames, summary = merged.paired(), merged.frames(), merged.summary(grouping)
    if out is not None:
        write_summary(summary.frame, outputs["summary"])
    campaign = campaign.with_copies(merged.copies(campaign.events))
    rows = keeper.finished()
    by_group = RowsByGroup(rows, summary.frame)
    in_parts = sorted({int(g) for batch in batches if not batch.whole for g in batch.group_of_exchange})
    details = collect_details(campaign, frames, by_group, in_parts, wanted)
    evidence = Evidence(campaign, exchanges, paired, grouping, summary, details)
    if details.requested:
        remarks += size_findings(evidence, None if sketch else by_group, in_parts)
    return Analysis(
        title=folder.resolve().name,
        sources=campaign.sources,
        sessions=tuple(sorted(campaign.sessions.values(), key=lambda s: (s.wall_anchor_ns, s.session_id))),
        runs=_runs_by_start(campaign, exchanges),
        rows=rows,
        summary=summary.frame,
        distributions=summary.distributions,
        timeline=frames["timeline"],
        timeline_decimated=frames["timeline"].height < merged.rows,
        findings=(*find_findings(evidence), *remarks),
        outputs=outputs,
        details=details,
    )


def _batches(grouping: Grouping, wanted: Wanted, *, with_rows: bool) -> Iterator[Work]:
    exchanges = grouping.exchanges
    for plan in plan_batches(exchanges, grouping.group_of_exchange):
        here = slice(plan.first, plan.after)
        groups = grouping.group_of_exchange[here]
        yield Work(exchanges[here], groups, len(exchanges), plan.whole, with_rows, wanted)


def _runs_by_start(campaign: Campaign, exchanges: Exchanges) -> tuple[Run, ...]:
    """Runs with messages in the order of their rows, then those without."""
    started = {exchange.run.run_id: exchange.run for exchange in exchanges.held}
    return (*started.values(), *(run for run_id, run in campaign.runs.items() if run_id not in started))


def _nothing_to_pair(campaign: Campaign, exchanges: Exchanges) -> str:
    reasons = {
        f"{counted(unplaced.events, 'event')} of run {unplaced.run_id:016x} in {campaign.names(unplaced.traces)}"
        for unplaced in exchanges.unplaced
    }
    found = f": {'; '.join(sorted(reasons))}" if reasons else ""
    return (
        f"{campaign.folder}: {counted(len(campaign.traces), 'trace')}, but no published message (T1) with its run and session "
        f"description{found}; add the trace of the ping"
    )

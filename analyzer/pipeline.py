"""From a folder of traces to one `Analysis`, step by step."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from analyzer.analysis import Analysis
from analyzer.evidence import Evidence
from analyzer.exchanges import find_exchanges
from analyzer.findings import find_findings
from analyzer.frames import Batch, concatenate_frames, frames_of
from analyzer.load import load_campaign
from analyzer.output import write_frames
from analyzer.roundtrips import pair_exchanges
from analyzer.summarize import group_exchanges, summarize_groups
from tracefile import MissingEventsError

if TYPE_CHECKING:
    import os

    from analyzer.exchanges import Exchanges
    from analyzer.load import Campaign, Progress
    from tracefile import Run

OUTPUT_FOLDER = "analysis"
"""Where results go by default, below the analyzed folder."""


def default_output(path: Path) -> Path:
    """The folder for the results of `path`: `analysis/` in it, or beside it if it is itself a trace."""
    is_trace = path.is_file() or (path / "metadata.yaml").is_file()
    return (path.parent if is_trace else path) / OUTPUT_FOLDER


def analyze(
    path: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Analysis:
    """Analyze every trace in a folder.

        from analyzer import analyze
        a = analyze("runs/")
        a.summary.select("vendor", "payload_bytes", "latency_p50_ns", "latency_p99_ns")

    Args:
        path: a folder (looked through to its depths), one trace file, or one rosbag2 folder.
        out: folder for `roundtrips.parquet` and `summary.parquet`; None writes nothing. It is never looked
            into for traces, nor is `analysis/` in `path`.
        progress: called before each trace is read with the number done, the number of all, and its path.

    Raises:
        MissingEventsError: there is no trace, or no published message in any.
        TraceFormatError: `path` is one file, and it is no trace.
        OutputError: the results cannot be written.
    """
    folder = Path(path)
    own = {default_output(folder)} | ({Path(out)} if out is not None else set())
    campaign = load_campaign(folder, skip=own, progress=progress)
    exchanges = find_exchanges(campaign)
    if not exchanges.held:
        raise MissingEventsError(_nothing_to_pair(campaign, exchanges))

    roundtrips = pair_exchanges(exchanges.held)
    grouping = group_exchanges(exchanges.held)
    summary = summarize_groups(roundtrips, grouping)
    batch = Batch(roundtrips, grouping.group_of_exchange, len(exchanges.held))
    frames = concatenate_frames([frames_of(batch)])
    findings = find_findings(Evidence(campaign, exchanges, roundtrips, grouping, summary))
    outputs = write_frames(roundtrips, summary.frame, Path(out)) if out is not None else {}
    return Analysis(
        title=folder.resolve().name,
        sources=campaign.sources,
        sessions=tuple(sorted(campaign.sessions.values(), key=lambda s: (s.wall_anchor_ns, s.session_id))),
        runs=_runs_by_start(campaign, exchanges),
        roundtrips=roundtrips.frame,
        summary=summary.frame,
        distributions=summary.distributions,
        timeline=frames["timeline"],
        timeline_decimated=frames["timeline"].height < roundtrips.frame.height,
        findings=findings,
        outputs=outputs,
    )


def _runs_by_start(campaign: Campaign, exchanges: Exchanges) -> tuple[Run, ...]:
    """Runs with messages in the order of their rows, then those without."""
    started = {exchange.run.run_id: exchange.run for exchange in exchanges.held}
    return (*started.values(), *(run for run_id, run in campaign.runs.items() if run_id not in started))


def _nothing_to_pair(campaign: Campaign, exchanges: Exchanges) -> str:
    reasons = {
        f"{unplaced.events} events of run {unplaced.run_id:016x} in {campaign.names(unplaced.traces)}"
        for unplaced in exchanges.unplaced
    }
    found = f": {'; '.join(sorted(reasons))}" if reasons else ""
    return (
        f"{campaign.folder}: {len(campaign.traces)} traces, but no published message (T1) with its run and session "
        f"description{found}; add the trace of the ping"
    )

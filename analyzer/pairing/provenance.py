"""Metadata of the Parquet files: program, contract, traces, time and clocks of the recording.

The keys are part of the contract (`docs/trace-format.md`). Equal input gives equal bytes: no time of the analysis.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from dds_trace.base.version import __version__
from dds_trace.tracefile.format.json_fields import FORMAT_VERSION

from ..loading.campaign import Campaign
from .exchanges import Exchanges
from .utc import is_synchronized, utc_text

MOST_NAMED = 1000
"""Traces and sessions that are listed: a reader loads all of it with the schema."""


def provenance(campaign: Campaign, exchanges: Exchanges) -> Mapping[str, str]:
    read = sorted(source.path for source in campaign.sources if source.status != "skipped")
    sessions = sorted(campaign.sessions.values(), key=lambda session: (session.wall_anchor_ns, session.session_id))
    clocks = [
        {
            "session_id": f"{session.session_id:016x}",
            "role": session.role,
            "device": session.device,
            "started": utc_text(session.wall_anchor_ns),
            "synchronized": is_synchronized(session),
        }
        for session in sessions[:MOST_NAMED]
    ]
    spans = [(exchange.start_ns, exchange.end_ns) for exchange in exchanges.placed]
    spans = spans or [(session.wall_anchor_ns, session.wall_anchor_ns) for session in sessions]  # only taps
    recorded = {"first": utc_text(min(first for first, _ in spans)), "last": utc_text(max(last for _, last in spans))}
    values = {
        "sources": {"folder": campaign.folder.resolve().name, "count": len(read), "names": read[:MOST_NAMED]},
        "recorded": recorded,
        "clocks": {"count": len(sessions), "sessions": clocks},
    }
    return {
        "dds_trace.version": __version__,
        "dds_trace.contract": f"docs/trace-format.md, format {FORMAT_VERSION}",
        **{f"dds_trace.{key}": json.dumps(value) for key, value in values.items()},
    }


def read_provenance(folder: Path) -> Mapping[bytes, bytes] | None:
    try:
        return dict(pq.read_schema(folder / "summary.parquet").metadata or {})
    except (OSError, UnicodeEncodeError, pa.ArrowException):  # pyarrow takes no path that is not UTF-8
        return None

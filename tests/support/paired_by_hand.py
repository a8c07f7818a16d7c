"""Round trips of a frame as a batch of paired exchanges, which the frames of groups are made of."""

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import polars as pl

from dds_trace.analyzer.groups.batch import AnalysisOptions, Batch
from dds_trace.analyzer.model.parameters import PARAMETER_NAMES
from dds_trace.analyzer.pairing.counts import COUNT_SCHEMA
from dds_trace.analyzer.pairing.exchanges import Exchange
from dds_trace.analyzer.pairing.one_way import KNOT_SCHEMA
from dds_trace.analyzer.pairing.pair import LOSSES, OUTCOMES
from dds_trace.analyzer.pairing.roundtrips import MIDDLEWARE_STAMPS, RoundTrips

_STAMPS = [name for names in MIDDLEWARE_STAMPS.values() for name in names]


def paired(
    frame: pl.DataFrame,
    *,
    deadline_ns: int | None = None,
    metric: str = "response",
    unsent: Mapping[tuple[int, int], int] | None = None,
    ping_wall: Mapping[int, int] | None = None,
    relay_wall: Mapping[int, int] | None = None,
    whole: bool = True,
) -> tuple[Batch, RoundTrips]:
    """The batch of these rows and what pairing makes of it.

    Args:
        frame: rows of `roundtrip_frames.roundtrips`; exchanges are in the order of their first rows, by `group` where there
            is such a column (else all are of group 0), and their rows by sequence number.
        deadline_ns: what is asked for.
        metric: what the deadline is for.
        unsent: (run_id, relay_id) -> messages that were due and never left.
        ping_wall: run_id -> wall clock minus monotonic clock of the ping in ns, 0 where it is missing.
        relay_wall: relay_id -> the same of the relay; without, its trace is missing.
        whole: False for a part of a group.
    """
    frame = frame if "group" in frame.columns else frame.with_columns(group=pl.lit(0, pl.UInt32))
    keys = ["group", "run_id", "relay_id"]
    parts = [
        part.sort("sequence")
        for part in frame.sort("group", maintain_order=True).partition_by(keys, maintain_order=True)
    ]
    ordered = pl.concat([frame.head(0), *parts])
    codes = {outcome.value: code for code, outcome in enumerate(OUTCOMES)}
    batch = Batch(
        exchanges=tuple(_exchange(part, ping_wall or {}, relay_wall or {}) for part in parts),
        group_of_exchange=np.array([part["group"][0] for part in parts], np.uint32),
        all_exchanges=len(parts),
        whole=whole,
        options=AnalysisOptions(deadline_ns=deadline_ns, deadline_metric=metric),
    )
    roundtrips = RoundTrips(
        measured=ordered.drop("group", "run_id", "relay_id", *PARAMETER_NAMES, *_STAMPS, strict=False),
        described=pl.concat([ordered.head(0), *(part.head(1) for part in parts)]).select(
            "run_id", "relay_id", *PARAMETER_NAMES
        ),
        outcome=np.array([codes[outcome] for outcome in ordered["outcome"]], np.uint8),
        bounds=np.cumsum([0, *(part.height for part in parts)], dtype=np.int64),
        counts=pl.DataFrame([_counts(part, unsent or {}) for part in parts], schema=COUNT_SCHEMA),
        stamps=tuple(ordered[name].fill_null(0) for name in _STAMPS if name in ordered.columns),
        clock_knots=pl.DataFrame(schema=KNOT_SCHEMA),
    )
    return batch, roundtrips


def _exchange(rows: pl.DataFrame, ping_wall: Mapping[int, int], relay_wall: Mapping[int, int]) -> Exchange:
    run_id, relay_id = rows["run_id"][0], rows["relay_id"][0]
    relay = _session(relay_wall[relay_id]) if relay_id in relay_wall else None
    held: Any = SimpleNamespace(
        run=SimpleNamespace(run_id=run_id, rate_hz=rows["rate_hz"][0], extra={}),
        relay_id=relay_id,
        ping=_session(ping_wall.get(run_id, 0)),
        relay=relay,
        relay_recorded=rows["relay_in_ns"].null_count() < rows.height,
    )
    return cast("Exchange", held)


def _session(wall_ns: int) -> SimpleNamespace:
    return SimpleNamespace(wall_anchor_ns=wall_ns + 7, monotonic_anchor_ns=7)


def _counts(rows: pl.DataFrame, unsent: Mapping[tuple[int, int], int]) -> dict[str, int | None]:
    of_outcome = dict(rows["outcome"].value_counts().iter_rows())
    return {
        **dict.fromkeys(COUNT_SCHEMA),
        **{outcome: of_outcome.get(outcome, 0) for outcome in LOSSES},
        "unsent": unsent.get((rows["run_id"][0], rows["relay_id"][0]), 0),
    }

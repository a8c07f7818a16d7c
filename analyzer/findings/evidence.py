"""The results that the checks behind the findings look at, and the names by which findings call things."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from ..clocks.boots import ping_boots
from ..model.names import name_groups
from ..pairing.one_way import pair_devices

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    import polars as pl

    from dds_trace.tracefile.format.descriptions import Session

    from ..analysis import Details
    from ..groups.batch import AnalysisOptions, Grouping
    from ..groups.summary import Summary
    from ..loading.campaign import Campaign
    from ..pairing.exchanges import Exchange, Exchanges
    from ..pairing.one_way import DevicePair
    from ..pairing.rows import RowStore

SMALLER_DATAGRAMS = "send smaller datagrams (Cyclone DDS MaxMessageSize, Fast DDS maxMessageSize), or raise net.ipv4.ipfrag_high_thresh"
"""What to set where IP fragments are lost."""

_MOST_FILES = 2
"""Files that a session's name lists: those of a long sweep would fill a screen."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """The results of every step of one analysis.

    Attributes:
        campaign: the traces, sessions and runs.
        exchanges: who exchanged messages with whom, and the events that belong to no exchange.
        grouping: the exchanges by group.
        summary: counts and statistics.
        details: the details, empty if they were not requested.
        rows: the round trips; a sketch has none.
        in_parts: groups that no batch held whole.
        options: the options of the analysis.
        stale_rows: file with the rows of an earlier analysis, which this one does not replace.
        sending: how each run was sent (`sending.sending_frame`).
        shapes: what the latency of each run does over its time (`shapes.shape_frame`); empty without details.
    """

    campaign: Campaign
    exchanges: Exchanges
    grouping: Grouping
    summary: Summary
    details: Details
    rows: RowStore
    in_parts: tuple[int, ...]
    options: AnalysisOptions
    stale_rows: Path | None
    sending: pl.DataFrame
    shapes: pl.DataFrame

    def counts_by_run(self) -> dict[int, tuple[Exchange, dict[str, int]]]:
        """Return for each run_id one exchange of the run (all share run and T1) and its row of counts."""
        counts = self.summary.of_exchange.iter_rows(named=True)
        return {e.run.run_id: (e, row) for e, row in zip(self.grouping.exchanges, counts, strict=True)}

    @cached_property
    def group_names(self) -> list[str]:
        """For each group a short name that tells it from the others (`names.name_groups`)."""
        return name_groups(self.grouping.parameters)

    @cached_property
    def device_pairs(self) -> tuple[DevicePair, ...]:
        """The clock fits of the campaign, which several checks look at (`device_pairs.pair_devices`)."""
        boots = ping_boots(self.campaign.sessions.values(), self.campaign.runs.values())
        return tuple(pair_devices(self.details.clock_fits, self.details.clock_knots, boots))

    def exchange_groups(self) -> list[int]:
        """Return the group of each exchange in `grouping`."""
        return [int(group) for group in self.grouping.group_of_exchange]

    @cached_property
    def groups_of_sessions(self) -> Mapping[int, tuple[int, ...]]:
        """Session -> the groups that it took part in; a session without an exchange is missing."""
        groups: dict[int, dict[int, None]] = defaultdict(dict)
        for exchange, group in zip(self.grouping.exchanges, self.exchange_groups(), strict=True):
            for session in (exchange.ping, exchange.relay):
                if session is not None:
                    groups[session.session_id][group] = None
        return {session_id: tuple(own) for session_id, own in groups.items()}

    def session_name(self, session: Session) -> str:
        """Name a session: `relay on beta (relay.mcap)`."""
        traces = sorted(set(self.campaign.session_traces[session.session_id]))
        named = some((self.campaign.name(trace) for trace in traces), _MOST_FILES)
        return f"{session.role} on {session.device} ({named})"

    def run_name(self, run_id: int) -> str:
        """Name a run: `run 1122334455667788 (ping.mcap)`."""
        traces = self.campaign.run_traces.get(run_id, ())
        return f"run {run_id:016x}" + (f" ({self.campaign.names(traces)})" if traces else "")


def exchange_name(exchange: Exchange) -> str:
    """Name an exchange: `run 1122334455667788, relay 0000beef on beta`."""
    device = f" on {exchange.relay.device}" if exchange.relay else ""
    return f"run {exchange.run.run_id:016x}, relay {exchange.relay_id:08x}{device}"


def some(names: Iterable[str], at_most: int = 3) -> str:
    """List the first names, and how many more there are."""
    listed = list(names)
    shown = "; ".join(listed[:at_most])
    return shown if len(listed) <= at_most else f"{shown}; and {len(listed) - at_most} more"


def percent(part: float, whole: float) -> str:
    """Print a share with as many digits as it takes to tell it from 0 and from 100 %."""
    share = 100 * part / whole
    return f"{share:.3g} %" if share < 99 else f"{share:.6g} %"

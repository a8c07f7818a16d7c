"""What the checks behind the findings look at, and how they name it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable

    from analyzer.analysis import Details
    from analyzer.exchanges import Exchange, Exchanges
    from analyzer.load import Campaign
    from analyzer.pair import Published
    from analyzer.roundtrips import PairedExchanges
    from analyzer.summarize import Grouping, Summary
    from tracefile import Session

_ALWAYS_NAMED = ("vendor", "data_type", "payload_bytes", "rate_hz", "domain_mode")
"""Parameters that a group's name starts with; others follow where they tell groups apart."""


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The results of every step of one analysis; `details` None where they were not asked for."""

    campaign: Campaign
    exchanges: Exchanges
    roundtrips: PairedExchanges
    grouping: Grouping
    summary: Summary
    details: Details | None = None

    def published_by_run(self) -> dict[int, tuple[Exchange, Published]]:
        """run_id -> one exchange of the run (all share run and T1) and the run's messages."""
        held = zip(self.roundtrips.exchanges, self.roundtrips.published, strict=True)
        return {exchange.run.run_id: (exchange, published) for exchange, published in held}

    def group_names(self) -> list[str]:
        """For each group a name that tells it from the others: `fastdds, binary 33000 B at 10 Hz, same domain`."""
        parameters = self.grouping.parameters
        telling = [
            name
            for name in parameters.columns
            if name not in _ALWAYS_NAMED and parameters[name].n_unique() > 1
        ]
        return [_group_name(row, telling) for row in parameters.iter_rows(named=True)]

    def session_name(self, session: Session) -> str:
        """`relay on beta (relay.mcap)`."""
        traces = self.campaign.names(self.campaign.session_traces[session.session_id])
        return f"{session.role} on {session.device} ({traces})"

    def run_name(self, run_id: int) -> str:
        """`run 1122334455667788 (ping.mcap)`."""
        traces = self.campaign.run_traces.get(run_id, ())
        return f"run {run_id:016x}" + (f" ({self.campaign.names(traces)})" if traces else "")


def exchange_name(exchange: Exchange) -> str:
    """`run 1122334455667788, relay 0000beef on beta`."""
    device = f" on {exchange.relay.device}" if exchange.relay else ""
    return f"run {exchange.run.run_id:016x}, relay {exchange.relay_id:08x}{device}"


def some(names: Iterable[str], at_most: int = 3) -> str:
    """The first few names and how many more there are."""
    held = list(names)
    shown = "; ".join(held[:at_most])
    return shown if len(held) <= at_most else f"{shown}; and {len(held) - at_most} more"


def percent(part: float, whole: float) -> str:
    """A share with as many digits as it takes to tell it from 0 and from 100 %."""
    share = 100 * part / whole
    return f"{share:.3g} %" if share < 99 else f"{share:.6g} %"


def _group_name(row: dict[str, Any], telling: list[str]) -> str:
    name = f"{row['vendor']}, {row['data_type']} {row['payload_bytes']} B at {row['rate_hz']:g} Hz, {row['domain_mode']} domain"
    return ", ".join([name, *(f"{parameter} {row[parameter]}" for parameter in telling)])

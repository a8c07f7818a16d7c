"""What checks look at, and the record of a check."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path

import polars as pl

from dds_trace.base.units import first_of
from dds_trace.tracefile.format.descriptions import Session

from ..analysis import Details
from ..clocks.boots import ping_boots
from ..groups.batch import AnalysisOptions, Grouping
from ..groups.summary import Summary
from ..loading.campaign import Campaign
from ..model.detail_frames import Topics
from ..model.finding import Finding, Severity, Subject
from ..model.names import name_groups
from ..pairing.exchanges import Exchange, Exchanges
from ..pairing.one_way import DevicePair, pair_devices
from ..pairing.rows import RowStore

SMALLER_DATAGRAMS = "smaller datagrams (Cyclone DDS MaxMessageSize, Fast DDS maxMessageSize) or a larger net.ipv4.ipfrag_high_thresh may help"

_MOST_FILES = 2
"""Files in a recording's name: a long sweep would fill a screen."""


@dataclass(frozen=True, slots=True)
class Observation:
    """What a check saw; `blanks` are for the `{names}` in its action."""

    where: str
    what: str
    groups: tuple[int, ...] = ()
    effect: float = 1.0
    blanks: Mapping[str, object] = field(default_factory=dict)
    cure: str = ""


@dataclass(frozen=True, eq=False)
class Evidence:
    """The results of an analysis; `stale_rows` is an earlier one's file that stays."""

    campaign: Campaign
    exchanges: Exchanges
    grouping: Grouping
    summary: Summary
    details: Details
    rows: RowStore
    in_parts: tuple[int, ...]
    options: AnalysisOptions
    stale_rows: Path | None
    topics: Topics
    sending: pl.DataFrame
    shapes: pl.DataFrame

    def result(self, group: int, what: str, effect: float = 1.0, **blanks: object) -> Observation:
        return Observation(self.group_names[group], what, (group,), effect, blanks)

    def recording(self, session: Session, what: str, effect: float = 1.0) -> Observation:
        groups = self.groups_of_sessions.get(session.session_id, ())
        return Observation(self.session_name(session), what, groups, effect)

    def run(self, run_id: int, what: str, groups: tuple[int, ...] = (), effect: float = 1.0) -> Observation:
        return Observation(self.run_name(run_id), what, groups, effect)

    def rows_by_group(self, *columns: str) -> Iterator[tuple[int, dict[str, int]]]:
        return enumerate(self.summary.frame.select(columns).iter_rows(named=True))

    def exchanges_by_group(self) -> Iterator[tuple[Exchange, int]]:
        return zip(self.grouping.exchanges, self.grouping.group_of_exchange.tolist(), strict=True)

    @cached_property
    def _counts(self) -> list[dict[str, int]]:
        return self.summary.exchange_counts.to_dicts()

    @cached_property
    def beacons(self) -> frozenset[int]:
        roles: dict[int, set[object]] = defaultdict(set)
        for exchange, group in self.exchanges_by_group():
            roles[group].add(exchange.run.labels.get("role"))
        return frozenset(group for group, names in roles.items() if names == {"beacon"})

    def counts_by_exchange(self) -> Iterator[tuple[Exchange, int, dict[str, int]]]:
        rows = zip(self.exchanges_by_group(), self._counts, strict=True)
        return ((exchange, group, row) for (exchange, group), row in rows)

    @cached_property
    def _frames(self) -> dict[Callable[[Evidence], pl.DataFrame], pl.DataFrame]:
        return {}

    def frame(self, make: Callable[[Evidence], pl.DataFrame]) -> pl.DataFrame:
        if make not in self._frames:
            self._frames[make] = make(self)
        return self._frames[make]

    @cached_property
    def group_names(self) -> list[str]:
        return name_groups(self.grouping.parameters)

    @cached_property
    def device_pairs(self) -> tuple[DevicePair, ...]:
        boots = ping_boots(self.campaign.sessions.values(), self.campaign.runs.values())
        return tuple(pair_devices(self.details.clock_fits, self.details.clock_knots, boots))

    @cached_property
    def groups_of_sessions(self) -> Mapping[int, tuple[int, ...]]:
        return self.groups_by_session(lambda _session, _payload_bytes: True)

    def groups_by_session(self, concerns: Callable[[Session, int], bool]) -> Mapping[int, tuple[int, ...]]:
        groups: dict[int, dict[int, None]] = defaultdict(dict)
        for exchange, group in self.exchanges_by_group():
            sides = [session for session in (exchange.ping, exchange.relay) if session is not None]
            if any(concerns(session, exchange.run.payload_bytes) for session in sides):
                for session in sides:
                    groups[session.session_id][group] = None
        return {session_id: tuple(numbers) for session_id, numbers in groups.items()}

    def session_name(self, session: Session) -> str:
        traces = sorted(set(self.campaign.session_traces[session.session_id]))
        files = some((self.campaign.name(trace) for trace in traces), _MOST_FILES)
        return f"{session.role} on {session.device} ({files})"

    def run_name(self, run_id: int) -> str:
        traces = self.campaign.run_traces.get(run_id, ())
        return f"run {run_id:016x}" + (f" ({self.campaign.names(traces)})" if traces else "")


def exchange_name(exchange: Exchange) -> str:
    device = f" on {exchange.relay.device}" if exchange.relay else ""
    return f"run {exchange.run.run_id:016x}, relay {exchange.relay_id:08x}{device}"


def some(names: Iterable[str], at_most: int = 3) -> str:
    return "; ".join(first_of([*names], at_most))


def percent(part: float, whole: float) -> str:
    share = 100 * part / whole
    return f"{share:.3g} %" if share < 99 else f"{share:.6g} %"


Observe = Callable[["Evidence"], Iterator["Observation"]]


_NOT_OF_BEACONS = frozenset(
    ["overlapping_pings", "unfinished_run", "loss", "outage", "late_sends", "schedule_not_held", "few_samples"]
)


@dataclass(frozen=True, slots=True)
class Check:
    """One kind of finding; calling it yields its findings."""

    code: str
    severity: Severity
    title: str
    action: str
    subject: Subject
    observe: Observe

    def __call__(self, evidence: Evidence) -> Iterator[Finding]:
        for seen in self.observe(evidence):
            if self.code in _NOT_OF_BEACONS and not evidence.beacons.isdisjoint(seen.groups):
                continue
            action, cure = map(evidence.campaign.remedy, (self.action.format(**seen.blanks), seen.cure))
            seen_there = seen.where, seen.what, action, seen.groups
            yield Finding(self.severity, self.code, *seen_there, effect=seen.effect, subject=self.subject, cure=cure)


def _check(severity: Severity, code: str, subject: Subject, action: str) -> Callable[[Observe], Check]:
    """Make a `Check` of a function; its docstring's first line is the title."""

    def decorate(observe: Observe) -> Check:
        title = (observe.__doc__ or code).partition("\n")[0].rstrip(".")
        return Check(code, severity, title, action, subject, observe)

    return decorate


error, warning, note = (partial(_check, severity) for severity in (Severity.ERROR, Severity.WARNING, Severity.INFO))

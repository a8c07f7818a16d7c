"""Why two sides of a comparison are not alike, or not fit to be judged: environments and findings of severity error."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, NamedTuple

import polars as pl

from dds_trace.analyzer.model.environment import lasting_parts
from dds_trace.analyzer.model.finding import Finding, Severity
from dds_trace.analyzer.model.parameters import ParameterValue
from dds_trace.analyzer.model.runs import pass_numbers
from dds_trace.base.units import SECOND_NS, first_of
from dds_trace.tracefile.format.descriptions import Run, Session
from dds_trace.tracefile.format.json_fields import number_of

from .matching import AGAINST_LABEL, CELL_LABEL, Key

SAME, UNKNOWN = "same", "unknown"
_MACHINE_COLUMNS = ("cpu_percent", "cpu_mhz", "temperature_c")
LEAST_BUSIER, MORE_OF_OURS, SLOWER_CLOCK = 0.1, 1.25, 0.9


class Recorder(NamedTuple):
    role: str
    vendor: str
    device: str
    connectivity: str

    def __str__(self) -> str:
        return f"{self.role} of {self.vendor} on {self.device}, {self.connectivity}"


class Unlike(NamedTuple):
    field: str
    base: frozenset[str]
    new: frozenset[str]


Differences = Mapping[Recorder, Sequence[Unlike]]
"""Recorders with a fingerprint on both sides -> the fields in which they differ."""


def environment_differences(
    base: Iterable[Session], new: Iterable[Session], names: Mapping[str, str] | None = None
) -> Differences:
    """Return the fields of the fingerprint in which the two sides differ, by recorder.

    What follows from the options, changes from minute to minute (`model.environment`), or is missing on one side is no difference.
    """
    before, after = _fields(base, {}), _fields(new, names or {})
    return {
        recorder: [
            Unlike(field, frozenset(values), frozenset(after[recorder][field]))
            for field, values in fields.items()
            if field in after[recorder] and after[recorder][field] != values
        ]
        for recorder, fields in before.items()
        if recorder in after
    }


def _fields(sessions: Iterable[Session], names: Mapping[str, str]) -> Mapping[Recorder, dict[str, set[str]]]:
    by_recorder: dict[Recorder, dict[str, set[str]]] = {}
    for session in sessions:
        parts = lasting_parts(session)
        if not parts:
            continue
        device = names.get(f"{session.role}_device", session.device)
        recorder = Recorder(session.role, session.vendor, device, session.connectivity)
        fields = by_recorder.setdefault(recorder, defaultdict(set))
        for field, value in parts.items():
            fields[field].add(json.dumps(value, sort_keys=True))
    return by_recorder


def difference_sentences(differences: Differences) -> tuple[str, ...]:
    alike: dict[Unlike, list[Recorder]] = defaultdict(list)
    for recorder, fields in differences.items():
        for unlike in fields:
            alike[unlike].append(recorder)
    return tuple(
        f"{unlike.field} differs ({'; '.join(map(str, recorders))}): base {_listed(unlike.base)}, "
        f"new {_listed(unlike.new)}."
        for unlike, recorders in alike.items()
    )


def side_names(differences: Differences) -> tuple[str, str] | None:
    """Return what to call base and new side: the version in which they differ, the middleware's or else a package's."""
    versions = [
        (recorder.vendor not in unlike.field, unlike.field.partition(".")[2], _listed(unlike.base), _listed(unlike.new))
        for recorder, fields in differences.items()
        for unlike in fields
        if unlike.field.startswith("versions.")
    ]
    if not versions:
        return None
    _, package, before, after = min(versions)
    return f"{package} {before}".replace('"', ""), f"{package} {after}".replace('"', "")


def environment_of_group(group: Mapping[str, ParameterValue], differences: Differences) -> str:
    ping = _alike(differences, "ping", *map(group.get, ("vendor", "ping_device", "connectivity")))
    relay = _alike(differences, "relay", *map(group.get, ("relay_vendor", "relay_device", "connectivity")))
    if not ping or not relay:
        return UNKNOWN
    fields = dict.fromkeys(
        f"{recorder.role} {unlike.field}" for recorder in (*ping, *relay) for unlike in differences[recorder]
    )
    return f"unlike: {', '.join(fields)}" if fields else SAME


def _alike(differences: Differences, role: str, *where: ParameterValue) -> list[Recorder]:
    vendor, device, connectivity = where
    recorders = [recorder for recorder in differences if recorder[:3] == (role, vendor, device)]
    return [recorder for recorder in recorders if recorder.connectivity == connectivity] or recorders


def _listed(values: frozenset[str]) -> str:
    return " ".join(first_of(sorted(values), 1))


def recorded_apart(base: Iterable[Session], new: Iterable[Session]) -> str:
    before, after = ([session.wall_anchor_ns for session in side if session.role == "ping"] for side in (base, new))
    if not before or not after or (min(before) <= max(after) and min(after) <= max(before)):
        return ""
    first, second = ("base", "new side") if max(before) < min(after) else ("new side", "base")
    return (
        f"the {first} was recorded before the {second}: a machine that changes with time looks like a change; "
        "`dds-trace sweep --against` interleaves the two."
    )


@dataclass(frozen=True, slots=True)
class SideError:
    text: str
    groups: frozenset[Key]

    def is_about(self, group: Key) -> bool:
        return not self.groups or group in self.groups


RunLoad = tuple[float, float, float, float]
"""Of the busiest machine: shares of its processors that others (the hypervisor, too) and the recorded programs took; MHz, Celsius."""


def run_loads(sides: Iterable[Any]) -> dict[int, RunLoad]:
    return {
        run_id: load for side in sides for run_id, load in _loads(side.sessions, side.runs, side.details.host_samples)
    }


def _loads(sessions: Iterable[Session], runs: Iterable[Run], samples: pl.DataFrame) -> Iterator[tuple[int, RunLoad]]:
    cores = {session.session_id: number_of(session.host.get("cpu_cores")) or 1.0 for session in sessions}
    ours = pl.sum_horizontal("node_cpu_percent", "bridge_cpu_percent")
    processors = pl.col("session_id").replace_strict(cores, default=1.0, return_dtype=pl.Float64)
    shares = samples.drop_nulls("cpu_percent").with_columns(ours=ours / processors)
    wall_ns, share, mhz, celsius = map(pl.col, ("wall_ns", *_MACHINE_COLUMNS))
    pings = [(run.run_id, int(str(run.extra.get("session_id", "0")), 16)) for run in runs]
    spans = (
        pl.DataFrame(pings, {"run_id": pl.UInt64, "session_id": pl.UInt64}, orient="row")
        .join(shares.group_by("session_id").agg(first=wall_ns.min() - SECOND_NS, last=wall_ns.max()), on="session_id")
        .drop("session_id")
    )
    machines = (
        shares.join_where(spans, wall_ns >= pl.col("first"), wall_ns <= pl.col("last"))
        .group_by("run_id", "device", "session_id")
        .agg(pl.col("ours", *_MACHINE_COLUMNS).mean())
        .group_by("run_id", "device")
        .agg(pl.col("ours").sum() / 100, share.mean() / 100, pl.col("cpu_mhz", "temperature_c").mean().fill_null(0.0))
        .select("run_id", share - pl.col("ours"), "ours", mhz, celsius)
        .sort(pl.all())
    )
    for run_id, *load in machines.iter_rows():
        yield run_id, (load[0], load[1], load[2], load[3])


def busier_side(base: Sequence[RunLoad], new: Sequence[RunLoad]) -> str:
    """Return which side's machine was busier or throttled, by the typical run; empty where it took more itself: that is no excuse."""
    if not base or not new:
        return ""
    typical = [[median(column) for column in zip(*runs, strict=True)] for runs in (base, new)]
    for side, busy, calm in (("base", *typical), ("new side", *reversed(typical))):
        is_hot = busy[2] < SLOWER_CLOCK * calm[2] and busy[3] > calm[3]
        if busy[1] <= MORE_OF_OURS * calm[1] + 0.01 and (busy[0] - calm[0] > LEAST_BUSIER or is_hot):
            others = f"other programs took {busy[0]:.0%} of the {side}'s processors, {calm[0]:.0%} on the other side"
            heat = f"the {side}'s processors were hotter, at {busy[2]:.0f} and not {calm[2]:.0f} MHz"
            return heat if is_hot else others
    return ""


class BusierRepeat(NamedTuple):
    cell: str
    repeat: int
    runs: tuple[int, int]
    reason: str


def busier_repeats(base: Sequence[Run], new: Sequence[Run], loads: Mapping[int, RunLoad]) -> list[BusierRepeat]:
    """Return interleaved repeats in which one side's machine was busier; of a cell none or fewer than half, which goes with a side."""
    passes = pass_numbers([*base, *new])
    partners = {(run.labels.get(CELL_LABEL), passes.get(run.run_id)): run.run_id for run in base if run.run_id in loads}
    by_cell: dict[str, list[BusierRepeat]] = defaultdict(list)
    for run in new:
        cell, repeat = run.labels.get(AGAINST_LABEL), passes.get(run.run_id)
        partner = partners.get((cell, repeat))
        if cell and repeat and partner is not None and run.run_id in loads:
            reason = busier_side([loads[partner]], [loads[run.run_id]])
            by_cell[cell].append(BusierRepeat(cell, repeat, (partner, run.run_id), reason))
    busier = [([item for item in repeats if item.reason], len(repeats)) for repeats in by_cell.values()]
    return [item for items, count in busier if 2 * len(items) < count for item in items]


WHOLE_RECORDING = frozenset({"recorder_drops", "recording_stopped", "bridge_failed", "ended_by_error"})
"""Errors of a whole recording: they may have spoiled more than they name, so no group of that side is judged."""


def errors_of(side: str, findings: Iterable[Finding], groups: Sequence[Key]) -> Iterator[SideError]:
    alike: dict[tuple[str, frozenset[Key]], list[Finding]] = defaultdict(list)
    for finding in findings:
        if finding.severity is Severity.ERROR:
            is_whole = finding.code in WHOLE_RECORDING
            about = frozenset() if is_whole else frozenset(groups[number] for number in finding.groups)
            alike[finding.code, about].append(finding)
    for (code, about), errors in alike.items():
        where = " ".join(first_of([error.where for error in errors], 1))
        yield SideError(f"{side}: {code} ({where}): {errors[0].what}", about)

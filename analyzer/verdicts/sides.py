"""Why two sides of a comparison are not alike, or not fit to be judged: environments and findings of severity error."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from dds_trace.base.units import counted
from dds_trace.tracefile.format.descriptions import Session

from ..model.environment import lasting_parts
from ..model.finding import Finding, Severity
from ..model.parameters import ParameterValue

if TYPE_CHECKING:
    from .matching import Key


SAME, UNKNOWN = "same", "unknown"


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
    first, *others = sorted(values)
    return first + (f" and {counted(len(others), 'other')}" if others else "")


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


WHOLE_RECORDING = frozenset({"recorder_drops", "recording_stopped", "bridge_failed", "ended_by_error"})
"""Errors of a whole recording: they may have spoiled more than they name, so no group of that side is judged."""


def errors_of(side: str, findings: Iterable[Finding], groups: Sequence[Key]) -> Iterator[SideError]:
    for finding in findings:
        if finding.severity is Severity.ERROR:
            is_whole = finding.code in WHOLE_RECORDING
            about = frozenset() if is_whole else frozenset(groups[number] for number in finding.groups)
            yield SideError(f"{side}: {finding.code} ({finding.where}): {finding.what}", about)

"""What makes two sides of a comparison unlike, or one of them unfit for it: environments and findings of severity error."""

from __future__ import annotations

import json
from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from dds_trace.base.units import counted

from ..model.environment import lasting_parts
from ..model.finding import Severity

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from dds_trace.tracefile.format.descriptions import Session

    from ..model.finding import Finding
    from ..model.parameters import ParameterValue
    from .matching import Key


class Stratum(NamedTuple):
    """A role with its middleware, on one device and over one link: only within it environments are compared."""

    role: str
    vendor: str
    device: str
    connectivity: str

    def __str__(self) -> str:
        return f"{self.role} of {self.vendor} on {self.device}, {self.connectivity}"


class Unlike(NamedTuple):
    """A field of the fingerprint in which two sides differ: the values of each, as JSON."""

    field: str
    base: frozenset[str]
    new: frozenset[str]


if TYPE_CHECKING:
    Differences = Mapping[Stratum, Sequence[Unlike]]
    """Strata of which both sides have a fingerprint -> the fields in which they differ."""

SAME, UNKNOWN = "same", "unknown"
"""Words for the environments of a group: alike in every field, and without a fingerprint on one of the sides."""


def environment_differences(
    base: Iterable[Session], new: Iterable[Session], names: Mapping[str, str] | None = None
) -> Differences:
    """Return the fields of the fingerprint in which the two sides differ, by stratum.

    Pooled over devices, two that have changed places would look the same. What follows from what was asked for, and what
    changes from minute to minute, is no difference (`model.environment`), nor is a field that one side does not know.

    Args:
        base: sessions of the base.
        new: those of the new side.
        names: column (`ping_device`, `relay_device`) -> name that the only device of the new side takes
            (`strata.replaced_devices`).
    """
    before, after = _fields(base, {}), _fields(new, names or {})
    return {
        stratum: [
            Unlike(field, frozenset(values), frozenset(after[stratum][field]))
            for field, values in fields.items()
            if field in after[stratum] and after[stratum][field] != values
        ]
        for stratum, fields in before.items()
        if stratum in after
    }


def _fields(sessions: Iterable[Session], names: Mapping[str, str]) -> Mapping[Stratum, dict[str, set[str]]]:
    held: dict[Stratum, dict[str, set[str]]] = {}
    for session in sessions:
        parts = lasting_parts(session)
        if not parts:
            continue
        device = names.get(f"{session.role}_device", session.device)
        stratum = Stratum(session.role, session.vendor, device, session.connectivity)
        fields = held.setdefault(stratum, defaultdict(set))
        for field, value in parts.items():
            fields[field].add(json.dumps(value, sort_keys=True))
    return held


def difference_sentences(differences: Differences) -> tuple[str, ...]:
    """Return a sentence for each difference, strata that differ alike together."""
    alike: dict[Unlike, list[Stratum]] = defaultdict(list)
    for stratum, fields in differences.items():
        for unlike in fields:
            alike[unlike].append(stratum)
    return tuple(
        f"{unlike.field} differs ({'; '.join(map(str, strata))}): base {_listed(unlike.base)}, "
        f"new {_listed(unlike.new)}."
        for unlike, strata in alike.items()
    )


def environment_of_group(group: Mapping[str, ParameterValue], differences: Differences) -> str:
    """Return `same`, `unlike:` with the fields in which the sides differ for a group, or `unknown`.

    Args:
        group: parameters of the group.
        differences: those of the two sides.
    """
    ping = _alike(differences, "ping", *map(group.get, ("vendor", "ping_device", "connectivity")))
    relay = _alike(differences, "relay", *map(group.get, ("relay_vendor", "relay_device", "connectivity")))
    if not ping or not relay:
        return UNKNOWN
    unlike = dict.fromkeys(
        f"{stratum.role} {each.field}" for stratum in (*ping, *relay) for each in differences[stratum]
    )
    return f"unlike: {', '.join(unlike)}" if unlike else SAME


def _alike(
    differences: Differences,
    role: str,
    vendor: ParameterValue,
    device: ParameterValue,
    connectivity: ParameterValue,
) -> list[Stratum]:
    """Return the strata of a role of a group: over its link, or any where the relay names its own otherwise."""
    held = [stratum for stratum in differences if stratum[:3] == (role, vendor, device)]
    return [stratum for stratum in held if stratum.connectivity == connectivity] or held


def _listed(values: frozenset[str]) -> str:
    first, *others = sorted(values)
    return first + (f" and {counted(len(others), 'other')}" if others else "")


def recorded_apart(base: Iterable[Session], new: Iterable[Session]) -> str:
    """Return a sentence if one side was recorded wholly before the other began, by their wall clocks; else an empty text.

    Runs of one side are then alike in what changes with time (other load, temperature), which no spread between them shows.
    """
    before, after = ([each.wall_anchor_ns for each in side if each.role == "ping"] for side in (base, new))
    if not before or not after or (min(before) <= max(after) and min(after) <= max(before)):
        return ""
    first, second = ("base", "new side") if max(before) < min(after) else ("new side", "base")
    return (
        f"the {first} was recorded before the {second}: a machine that changes with time looks like a change; "
        "`dds-sweep --against` measures them in turns."
    )


@dataclass(frozen=True, slots=True)
class SideError:
    """A finding of severity error of one side.

    Attributes:
        text: the side and the finding in one sentence.
        groups: match columns of the groups it is about; empty where it is about the whole side.
    """

    text: str
    groups: frozenset[Key]

    def is_about(self, group: Key) -> bool:
        """Tell whether a group is not to be judged because of it."""
        return not self.groups or group in self.groups


OF_A_RECORDING = frozenset({"recorder_drops", "recording_stopped", "bridge_failed", "ended_by_error"})
"""Errors of a whole recording: what else they spoiled is not known, so no group of that side is judged, whichever they name."""


def errors_of(side: str, findings: Iterable[Finding], groups: Sequence[Key]) -> Iterator[SideError]:
    """Yield each finding of severity error.

    Args:
        side: `base` or `new`.
        findings: of that side.
        groups: match columns of the groups of that side, in the order of its summary.
    """
    for finding in findings:
        if finding.severity is Severity.ERROR:
            yield SideError(
                f"{side}: {finding.code} ({finding.where}): {finding.what}",
                frozenset(
                    () if finding.code in OF_A_RECORDING else (groups[number] for number in finding.groups)
                ),
            )

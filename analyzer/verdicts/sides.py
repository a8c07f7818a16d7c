"""What makes two sides of a comparison unlike, or one of them unfit for it: environments and findings of severity error."""

from __future__ import annotations

import json
from collections import defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.tracefile.units.counts import counted

from ..model.finding import Severity
from ..model.fingerprint import FLEETING, flat_fields

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    import polars as pl

    from dds_trace.tracefile import Session

    from ..model.finding import Finding
    from .matching import Key

    Fields = Mapping[tuple[str, str], frozenset[str]]
    """(role and middleware, field) -> the values, as JSON, that sessions of one side have."""


def environment_differences(base: Iterable[Session], new: Iterable[Session]) -> tuple[str, ...]:
    """Return a sentence for each field of the fingerprint in which the two sides differ.

    Sessions of equal role and middleware are compared; a field that one side does not know is no difference.
    """
    before, after = _fields(base), _fields(new)
    alike: dict[tuple[str, str, str], list[str]] = defaultdict(list)
    for (who, field), values in before.items():
        other = after.get((who, field))
        if other is not None and other != values:
            alike[field, _listed(values), _listed(other)].append(who)
    return tuple(
        f"{field} differs ({', '.join(who)}): base {old}, new {new}."
        for (field, old, new), who in alike.items()
    )


def _fields(sessions: Iterable[Session]) -> Fields:
    values: dict[tuple[str, str], set[str]] = defaultdict(set)
    for session in sessions:
        for field, value in flat_fields({k: v for k, v in session.host.items() if k not in FLEETING}):
            values[f"{session.role} of {session.vendor}", field].add(json.dumps(value, sort_keys=True))
    return {key: frozenset(held) for key, held in values.items()}


def _listed(values: frozenset[str]) -> str:
    first, *others = sorted(values)
    return first + (f" and {counted(len(others), 'other')}" if others else "")


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


def errors_of(side: str, findings: Iterable[Finding], groups: pl.DataFrame) -> Iterator[SideError]:
    """Yield each finding of severity error.

    Args:
        side: `base` or `new`.
        findings: of that side.
        groups: the match columns of the groups of that side, in the order of its summary.
    """
    for finding in findings:
        if finding.severity is Severity.ERROR:
            yield SideError(
                f"{side}: {finding.code} ({finding.where}): {finding.what}",
                frozenset(groups.row(number) for number in finding.groups),
            )

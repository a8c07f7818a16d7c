"""How it was recorded: a row for each setting, version or limit, a column for each device and role."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dds_trace.base.printable import printable

from .groups import format_count, qos_label, vendor_labels
from .recording import FLEETING, applied_words

if TYPE_CHECKING:
    from collections.abc import Iterator

    from dds_trace.analyzer.analysis import Analysis
    from dds_trace.tracefile.format.descriptions import Session

    from .groups import Groups, VendorLabels

MOST_COLUMNS = 16
"""Most devices and roles; the table of the sessions has the others."""
_MOST_VALUES = 4
"""Most values in one table cell; a sweep over a setting has one for each step."""

_VARIED = "Sessions"
_SECTIONS = {
    "versions": "Versions",
    "middleware": "Settings of the middleware",
    "settings": "Environment variables",
    "configuration": "Configuration",
    "socket_buffers": "Limits of socket buffers (bytes)",
    "mtu": "MTU of interfaces (bytes)",
}
"""Part of a fingerprint with several values -> its heading; the others are under the machine."""
_NAMES = {
    "cpu_model": "processor",
    "cpu_cores": "processors",
    "cpu_cores_physical": "cores",
    "cpu_governor": "governor",
    "cpu_max_mhz": "highest MHz",
    "os": "system",
    "kernel_realtime": "realtime kernel",
    "memory_bytes": "memory (bytes)",
}


@dataclass(frozen=True, slots=True)
class RecordedRow:
    """One value of all devices and roles, not escaped for a format.

    Attributes:
        values: of each column; empty where no session has it.
        unlike: whether it differs where it should not.
    """

    name: str
    values: tuple[str, ...]
    unlike: bool


@dataclass(frozen=True, slots=True)
class RecordedEnvironment:
    """Rows by section; columns are devices and roles, `quality` all qualities of service."""

    columns: tuple[str, ...]
    sections: tuple[tuple[str, tuple[RecordedRow, ...]], ...]
    quality: str


def recorded_environment(analysis: Analysis, groups: Groups) -> RecordedEnvironment | None:
    """Arrange the sessions' descriptions by device and role; None without sessions."""
    vendors = vendor_labels(analysis)
    described: dict[tuple[str, str], dict[str, dict[str, None]]] = {}
    columns: dict[str, None] = {}
    for session in sorted(analysis.sessions, key=lambda one: (one.device, one.role)):
        column = f"{printable(session.device)} ({printable(session.role)})"
        columns.setdefault(column)
        for section, name, value in _described(session, vendors):
            described.setdefault((section, name), {}).setdefault(column, {}).setdefault(value)
    if not columns:
        return None
    shown = tuple(columns)[:MOST_COLUMNS]
    sections: dict[str, list[RecordedRow]] = {}
    for (section, name), by_column in described.items():
        values = tuple(_joined(by_column.get(column, {})) for column in shown)
        distinct = [tuple(sorted(own)) for own in by_column.values()]
        # Middleware, domain and link are what a campaign varies on purpose.
        unlike = section != _VARIED and (len(set(distinct)) > 1 or any(len(own) > 1 for own in distinct))
        sections.setdefault(section, []).append(RecordedRow(name, values, unlike))
    ordered = [_VARIED, "Machine", "Seen in use", *_SECTIONS.values()]
    return RecordedEnvironment(
        shown,
        tuple((section, tuple(sections[section])) for section in ordered if section in sections),
        "; ".join(dict.fromkeys(qos_label(one) for one in groups.series)),
    )


def _described(session: Session, vendors: VendorLabels) -> Iterator[tuple[str, str, str]]:
    yield _VARIED, "middleware", vendors.of(session.vendor)
    yield _VARIED, "backend", printable(session.backend)
    if session.rmw:
        yield _VARIED, "RMW", printable(session.rmw)
    yield _VARIED, "domain", str(session.domain_id)
    yield _VARIED, "link", printable(session.connectivity)
    for words in applied_words(session):
        what, _, used = words.rpartition(" by ") if " by " in words else words.rpartition(" granted ")
        yield "Seen in use", what or words, used
    for name, value in session.host.items():
        if name == FLEETING or value is None or value in ({}, []):
            continue
        if isinstance(value, dict):
            for inner, one in value.items():
                yield _SECTIONS.get(name, "Machine"), printable(inner), _text(one)
        else:
            yield "Machine", _NAMES.get(name, printable(name).replace("_", " ")), _text(value)


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return format_count(value) if isinstance(value, int) else printable(value, 200)


def _joined(values: dict[str, None]) -> str:
    shown = list(values)
    more = [f"and {len(shown) - _MOST_VALUES} more"] if len(shown) > _MOST_VALUES else []
    return " or ".join(shown[:_MOST_VALUES] + more)

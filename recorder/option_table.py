"""The table of a recording's options, with choices and help."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path

from dds_trace.base import limits
from dds_trace.base.extension import offers
from dds_trace.base.units import parse_duration
from dds_trace.tracefile.format.descriptions import Qos

from .backends import BACKEND_MODULES
from .backends.node import NodeOptions
from .choices import Durability, FileMode, History, Reliability, Role
from .option import Axis, Option, option, options_of, parse_percentage
from .options import PingOptions, RecordOptions, TapOptions

_SENDERS = (Role.PING, Role.RELAY, Role.BEACON)


@dataclass(frozen=True, slots=True)
class CommandOptions:
    role: Role | None = option(
        None,
        "--role ROLE",
        "ping sends messages, relay sends them back, tap listens to --topics of others, beacon compares clocks.",
        kind=Role,
    )
    out: Path | None = option(
        None, "--out PATH", "Trace to write: a .mcap file, or the name of a rosbag2 folder.", kind=Path
    )
    force: bool = option(False, "--force", "Overwrite an existing trace.")
    fsync: bool = option(
        False,
        "--fsync",
        "Flush the trace to the disk twice a second, so that a power loss costs less than the last second.",
    )
    file_mode: FileMode = option(
        FileMode.GROUP, "--file-mode MODE", "Rights of the trace: 0640 (you write, your group reads) or 0600."
    )
    as_json: bool = option(False, "--json", "Print the result as JSON.")
    fail_if_lost: float | None = option(
        None,
        "--fail-if-lost PERCENT",
        "Exit with 13 if a ping loses more than this share of its messages, e.g. 1%.",
        parse=lambda text: parse_percentage("--fail-if-lost", text),
        roles=(Role.PING,),
    )
    reliability: Reliability = option(
        Reliability.RELIABLE,
        "--reliability QOS",
        "Delivery (tap: best_effort):",
        axis=Axis(meaning="QoS reliability of both sides"),
    )
    durability: Durability = option(
        Durability.VOLATILE,
        "--durability QOS",
        "Messages for late subscribers:",
        axis=Axis(meaning="QoS durability of both sides"),
    )
    history: History = option(
        History.KEEP_LAST,
        "--history QOS",
        "Messages in the queue:",
        roles=_SENDERS,
        axis=Axis(meaning="QoS history of both sides"),
    )
    depth: int = option(
        10,
        "--depth N",
        "Length of the queue with keep_last (tap: 32).",
        limit=limits.DEPTH,
        axis=Axis(meaning="messages that `keep_last` keeps, of both sides"),
    )
    deadline: int | None = option(
        None,
        "--deadline TIME",
        "Maximum period between two messages, e.g. 20ms.",
        parse=lambda text: parse_duration(text, "-o deadline"),
        roles=_SENDERS,
    )
    lifespan: int | None = option(
        None,
        "--lifespan TIME",
        "Maximum age of a message at delivery, e.g. 1.5s.",
        parse=lambda text: parse_duration(text, "-o lifespan"),
        roles=_SENDERS,
    )
    limits_path: Path | None = option(
        None,
        "--limits FILE",
        "A limits.toml that the topics have to meet; exit with 20 at the end if one does not (extra analyze).",
        kind=Path,
        roles=(Role.TAP,),
    )
    keep: int | None = option(
        None,
        "--keep N",
        "With rotate: keep only the newest N files of this recording.",
        kind=int,
        roles=(Role.RELAY, Role.TAP, Role.BEACON),
    )
    check: bool = option(
        False,
        "--check",
        "Start with these options and stop before the first message; keep no trace. Exit with 0 if recording can begin.",
    )

    @property
    def qos(self) -> Qos:
        durations = {"deadline_ns": self.deadline, "lifespan_ns": self.lifespan}
        return Qos(
            self.reliability.value,
            self.durability.value,
            self.history.value,
            self.depth,
            {name: time_ns for name, time_ns in durations.items() if time_ns is not None},
        )


OPTIONS: Mapping[str, Option] = {
    name: replace(row, roles=row.roles or roles)
    for record, roles in (
        (CommandOptions, ()),
        (PingOptions, (Role.PING,)),
        (TapOptions, (Role.TAP,)),
        (RecordOptions, ()),
        (NodeOptions, ()),
    )
    for name, row in options_of(record).items()
}
"""Rows by field; no two records share a name."""


_SHARED = ("out", "force", "json", "duration", "backend", "rmw", "domain")
_REACHED = (*_SHARED, "check", "discovery", "peer")
_PAIRED = (*_REACHED, "reliability", "depth", "configuration", "tuned", "wire")
OFTEN: Mapping[Role, tuple[str, ...]] = {
    Role.PING: (*_PAIRED, "data", "size", "rate", "messages", "bridge", "fail-if-lost"),
    Role.RELAY: (*_PAIRED, "type"),
    Role.TAP: (*_SHARED, "topics", "live", "payload", "limits"),
    Role.BEACON: (*_REACHED, "rate"),
}
"""Options that `--help` of a role shows; a person gives any other as `-o KEY=VALUE`."""


def is_setting(row: Option, role: Role | None = None) -> bool:
    return all(row.name[2:] not in ("role", *OFTEN[user]) for user in ([role] if role else Role))


def settings_of(role: Role) -> dict[str, Option]:
    return {row.name: row for row in OPTIONS.values() if role in (row.roles or Role) and is_setting(row, role)}


def typed_words(words: Sequence[str], role: Role) -> list[str]:
    rows = settings_of(role)
    typed, remaining = [], iter(words)
    for word in remaining:
        row = rows.get(word)
        typed += [word] if row is None else ["-o", f"{key_of(row)}={next(remaining) if row.metavar else flag_of(row)}"]
    return typed


def flag_of(row: Option) -> str:
    return "false" if row.name.startswith("--no-") else "true"


def key_of(row: Option) -> str:
    return row.name.removeprefix("--").removeprefix("no-").replace("-", "_")


def choices_of(row: Option) -> list[str]:
    names = {"--backend": lambda: BACKEND_MODULES, **offers("choices")}.get(row.name, tuple)
    values = [str(value.value) for value in row.kind] if issubclass(row.kind, Enum) else [*names()]
    default = getattr(row.field_default, "value", row.field_default)
    return list(dict.fromkeys([str(default), *values])) if values and default is not None else values


def help_of(row: Option) -> str:
    text, default = row.help, row.default
    if text.endswith(":"):
        *others, last = (name for name in choices_of(row) if name != "none")
        text = f"{text} {', '.join(others)} or {last}."
    if not default and row.metavar and row.field_default not in (None, (), {}, "none"):
        shown = getattr(row.field_default, "value", row.field_default)
        default = f"{shown:g}" if isinstance(shown, float) else str(shown)
    return f"{text} Default: {default}" if default not in ("", "default") else text

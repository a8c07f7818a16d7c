"""The settings that a recording was asked for: every option that changes the experiment and is not left at its default.

An option that is added to the records of `options.py` or to `NodeOptions` becomes a setting by itself. What does not
change the experiment, or is told elsewhere, stands in the two tables below with its reason.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from enum import Enum
from typing import TYPE_CHECKING

from .choices import Discovery

if TYPE_CHECKING:
    from collections.abc import Iterator

    from dds_trace.tracefile.format.json_fields import Json

    from .options import PingOptions, RecordOptions

NO_SETTINGS: Mapping[str, str] = {
    "destination": "the place of the trace",
    "ping": "the run's own settings",
    "relay_id": "a number of the relay, drawn by default",
    "types": "types that a relay serves beside those of the run",
    "duration_s": "the length of the recording",
    "strict": "ends a recording, and changes none",
    "own_cost": "a measurement before the node opens",
    "rotation": "the files of the trace",
    "keep_free": "the disk of the trace",
    "name": "drawn for every node",
    "listens": "follows from the role",
    "peers": "addresses, which no trace tells",
    "size_bytes": "`payload_bytes` of the run",
    "rate_hz": "`rate_hz` of the run",
    "messages": "the length of the run",
    "warmup": "the length of the warm-up",
    "wait_s": "the wait before the run",
    "relays": "the relays that took part are in the trace",
    "seed": "of random content",
    "bridge": "`bridge` of the run",
    "bridge_peers": "addresses, which no trace tells",
    "labels": "the user's own, which name a run and do not change it",
}
"""Options that are no settings, and the reason of each."""

DESCRIBED: Mapping[str, str] = {
    "domain_id": "`domain_id` of the session",
    "relay_domain_id": "`relay_domain_id` of the run",
    "backend": "`backend` of the session",
    "rmw": "`rmw` of the session, as the middleware itself reports it",
    "device": "`device` of the session",
    "connectivity": "`connectivity` of the session",
    "data": "`data_type` and `data_source` of the run",
    "bridge_running": "`bridge_running` of the run",
}
"""Options that a field of session or run tells as they took effect."""


def side_settings(options: RecordOptions, connectivity: str) -> dict[str, Json]:
    """Return the settings of a side, for its session.

    Args:
        options: options of the recording.
        connectivity: the session's. Discovery is left out where it is the usual one of this link: `localhost` over
            loopback, `subnet` over any other.
    """
    settings = dict(_changed(options))
    usual = Discovery.LOCALHOST if connectivity == "loopback" else Discovery.SUBNET
    settings.pop("discovery", None)
    if options.node.discovery is not usual:
        settings["discovery"] = options.node.discovery.value
    return settings


def run_settings(asked: PingOptions) -> dict[str, Json]:
    """Return the settings of a run, for its description."""
    settings = dict(_changed(asked))
    if asked.bridge_listen is not None:
        settings["bridge_listen"] = True  # that there are two halves; the address is nobody's business
    return settings


def _changed(record: object) -> Iterator[tuple[str, Json]]:
    """Yield name and value of each setting of a record of options that is not its default, records within it included."""
    assert is_dataclass(record)
    for field in fields(record):
        value = getattr(record, field.name)
        if field.name in NO_SETTINGS or field.name in DESCRIBED:
            continue
        if is_dataclass(value):
            yield from _changed(value)
        elif isinstance(value, Mapping):
            yield from value.items()
        elif value != _default(field):
            yield field.name, _json_of(value)


def _default(field: Field[object]) -> object:
    if field.default_factory is not MISSING:
        return field.default_factory()
    return field.default


def _json_of(value: object) -> Json:
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, tuple):
        return [_json_of(each) for each in value]
    return value if isinstance(value, bool | int | float) else str(value)

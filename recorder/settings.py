"""The settings of a recording: every option that changes the experiment and is not left at its default.

A new option is a setting unless its row says `in_key=False`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import Enum
from typing import TYPE_CHECKING

from .choices import Discovery

if TYPE_CHECKING:
    from collections.abc import Iterator

    from dds_trace.tracefile.format.json_fields import Json

    from .options import PingOptions, RecordOptions


def side_settings(options: RecordOptions, connectivity: str) -> dict[str, Json]:
    """Return the settings of a side, for its session.

    Discovery is left out where it is the usual one of this link: `localhost` over loopback, `subnet` over any other.
    """
    settings = dict(changed_settings(options))
    usual = Discovery.LOCALHOST if connectivity == "loopback" else Discovery.SUBNET
    settings.pop("discovery", None)
    if options.node.discovery is not usual:
        settings["discovery"] = options.node.discovery.value
    return settings


def run_settings(options: PingOptions) -> dict[str, Json]:
    """Return the settings of a run, for its description."""
    settings = dict(changed_settings(options))
    if options.bridge_listen is not None:
        settings["bridge_listen"] = True  # not the address, which is private
    return settings


def changed_settings(record: object) -> Iterator[tuple[str, Json]]:
    """Yield name and value of each setting of a record, and of the records in it, that is not its default."""
    assert is_dataclass(record)
    for column in fields(record):
        value = getattr(record, column.name)
        row = column.metadata.get("option")
        if not (column.metadata.get("in_key", True) if row is None else row.in_key):
            continue
        default = column.default if column.default_factory is MISSING else column.default_factory()
        if is_dataclass(value):
            yield from changed_settings(value)
        elif isinstance(value, Mapping):
            yield from value.items()
        elif value != default:
            yield column.name, _json_of(value)


def _json_of(value: object) -> Json:
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, tuple):
        return [_json_of(item) for item in value]
    return value if isinstance(value, bool | int | float) else str(value)

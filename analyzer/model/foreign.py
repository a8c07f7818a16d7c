"""Values of foreign traces, which may be any JSON."""

from __future__ import annotations

from dds_trace.tracefile.format.json_fields import JsonObject


def object_of(value: object) -> JsonObject:
    return value if isinstance(value, dict) else {}


def objects_of(values: object) -> list[JsonObject]:
    """Return the objects of a list; none for anything else."""
    return [object_of(value) for value in values] if isinstance(values, list) else []


def number_of(value: object) -> float | None:
    """Return a number that fits into 64 bits, else None (NaN too)."""
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return value if is_number and -(2.0**63) < value < 2.0**63 else None  # type: ignore[operator,return-value]  # narrowed above

"""The fingerprint of a device as plain fields, so that two of them can be compared."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

FLEETING = ("wifi",)
"""Parts of the fingerprint that change from one minute to the next on the same device."""


def flat_fields(host: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield the leaves of a nested object with their dotted names."""
    for key, value in host.items():
        if isinstance(value, dict):
            yield from flat_fields(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value

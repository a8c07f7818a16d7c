"""Entries of the cache whose description is another one, under this user's own seal."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing import Any

    from dds_trace.analyzer.cache.store import TraceCache


def describe_anew(cache: TraceCache, key: str, entry: dict[str, Any]) -> None:
    """Put another JSON behind the events of an entry."""
    _, events_bytes = cache.read_end(key)
    path = cache.path(key, "trace")
    events = path.read_bytes()[:events_bytes]
    with path.open("wb") as stream:
        stream.write(events)
        cache.write_end(key, stream, json.dumps(entry).encode())

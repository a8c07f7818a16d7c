"""An emulated link in words."""

from __future__ import annotations

import re

_WRITTEN = re.compile(r"(?P<name>[^()]+)\((?P<values>[^()]*)\)")

_WORDS = {
    "rate_mbit_s": "{} Mbit/s",
    "shared": "shared by both directions",
    "delay_ms": "delay {} ms",
    "jitter_ms": "jitter {} ms",
    "loss_percent": "loss {} %",
    "loss_burst": "in bursts of {}",
    "outage_ms": "outage {} ms",
    "outage_every_s": "every {} s",
    "queue_ms": "queue {} ms",
    "file": "as {} says",
}


def link_words(setting: str) -> str:
    """Return a link, as a run's setting has it (`air-30(queue_ms=400,rate_mbit_s=30)`), in words; other text as it is."""
    written = _WRITTEN.fullmatch(setting)
    if written is None:
        return setting
    values = dict(pair.partition("=")[::2] for pair in written["values"].split(",") if pair)
    parts = [
        _WORDS.get(key, f"{key} {{}}").format(values[key].partition("#")[0]) for key in _WORDS | values if key in values
    ]
    return f"{written['name']} ({', '.join(parts) or 'nothing shaped'})"

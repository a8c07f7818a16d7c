"""An emulated link in words."""

from __future__ import annotations

import re
from collections import defaultdict

_WRITTEN = re.compile(r"(?P<name>[^()]+)\((?P<values>[^()]*)\)")

_WORDS = {
    "rate_mbit_s": "{rate_mbit_s} Mbit/s",
    "shared": "shared by both directions",
    "delay_ms": "delay {delay_ms} ms",
    "jitter_ms": "jitter {jitter_ms} ms",
    "loss_percent": "loss {loss_percent} %",
    "loss_burst": "in bursts of {loss_burst}",
    "outage_ms": "outage {outage_ms} ms every {outage_every_s} s",
    "outage_every_s": "",
    "queue_ms": "queue {queue_ms} ms",
    "file": "as {file} says",
}


def link_words(setting: str) -> str:
    """Return a link, as a run's setting has it (`air-30(queue_ms=400,rate_mbit_s=30)`), in words; other text as it is."""
    written = _WRITTEN.fullmatch(setting)
    if written is None:
        return setting
    pairs = (pair.partition("#")[0].partition("=")[::2] for pair in written["values"].split(",") if pair)
    values = defaultdict(lambda: "?", pairs)
    if not {"rate_mbit_s", "file"} & values.keys():
        values.pop("queue_ms", None)  # nothing waits
    words = (_WORDS.get(key, f"{key} {values[key]}").format_map(values) for key in _WORDS | values if key in values)
    return f"{written['name']} ({', '.join(filter(None, words)) or 'nothing shaped'})"

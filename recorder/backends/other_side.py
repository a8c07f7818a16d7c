"""What this process does not accept of others, and relays that have security where the ping has none, or the other way round."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterable

from ..choices import Security

NOT_TEXT = "topic name that is not text"
"""Announced by a participant: Python's clients cannot list a graph that contains it."""


class Strangers:
    """Counts of what peers sent and this process did not accept, by kind."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._noted: set[str] = set()

    def count(self, kind: str, number: int = 1) -> None:
        with self._lock:
            self._counts[kind] += number

    def count_once(self, kind: str) -> None:
        if kind not in self.counts:
            self.count(kind)

    @property
    def counts(self) -> dict[str, int]:
        with self._lock:
            return dict(self._counts)

    def take_new(self) -> list[str]:
        new = sorted(self.counts.keys() - self._noted)
        self._noted.update(new)
        return new


_SECURED_NAME = re.compile(rf"dds_trace_\w+_({'|'.join(level.value.replace('-', '_') for level in Security)})")

LOOK_PATIENCE_S = 15.0
_LOOK = """
import json, sys, time
from dds_trace.recorder.backends import open_node
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery
with open_node(sys.argv[1], NodeOptions(int(sys.argv[2]), "dds_trace_look", Discovery(sys.argv[3]))) as node:
    time.sleep(2)
    print(json.dumps(node.participant_names()))
"""


def name_of_participant(name: str, security: Security) -> str:
    """Return a node's name; a secured one ends with its level, as only names are open to all."""
    return name if security is Security.OFF else f"{name}_{security.value.replace('-', '_')}"


def unlike_participant(names: Iterable[str], security: Security, network: Iterable[str]) -> str:
    """Return in words that of a relay and this node one has security, by `names` or a look at `network`."""
    secured = security is not Security.OFF
    for name in sorted(_names_without_security(*network) if secured else names):
        match = _SECURED_NAME.fullmatch(name)
        if name.startswith("dds_trace_relay_") and bool(match) is not secured:
            level = f"with -o security={match[1].replace('_', '-')}" if match else "without -o security"
            return f"{name} {level}, and this ping is {'with' if secured else 'without'}"
    return ""


def _names_without_security(*network: str) -> Iterable[str]:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("ROS_SECURITY_")}
    command = [sys.executable, "-c", _LOOK, *network]
    try:
        completed = subprocess.run(command, env=environment, capture_output=True, timeout=LOOK_PATIENCE_S, check=True)
        return map(str, json.loads(completed.stdout))
    except (OSError, subprocess.SubprocessError, ValueError):
        return ()

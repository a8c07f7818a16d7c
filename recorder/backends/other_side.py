"""A relay of a DDS domain that has security where the ping has none, or the other way round."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from typing import TYPE_CHECKING

from ..choices import Security

if TYPE_CHECKING:
    from collections.abc import Iterable

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
    """Return in words that there is a relay with security, or next to a secured node one without; the node sees `names`.

    `place` is the node's backend, domain and discovery range.
    """
    secured = security is not Security.OFF
    for name in sorted(_names_without_security(*network) if secured else names):
        match = _SECURED_NAME.fullmatch(name)
        if name.startswith("dds_trace_relay_") and bool(match) is not secured:
            level = f"with --security {match[1].replace('_', '-')}" if match else "without --security"
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

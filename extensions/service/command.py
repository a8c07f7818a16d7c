"""`dds-trace record status`: the recordings that run on this machine, and what killed ones left."""

from __future__ import annotations

import json
import shlex
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable
from dds_trace.cli.program import command, make_app, option

if TYPE_CHECKING:
    from .running import Listed

app = make_app()


@command(app, "status")
def status_command(as_json: Annotated[bool, option("--json", "Print the list as JSON.")] = False) -> None:
    """List the recordings that run on this machine.

    A killed one is listed with the command that recovers its events. Recordings of other users are shown if their runtime folders
    are readable.
    """
    from .running import list_recordings

    recordings = list_recordings()
    if as_json:
        listed = [
            {"state": entry.state.value, "ring_is_left": entry.waiting is not None, **asdict(entry.entry)}
            for entry in recordings
        ]
        print(json.dumps(listed))
        return
    for recording in recordings:
        print("\n".join(printable(line, MAX_FINDING_CHARACTERS) for line in _lines(recording)))
    if not recordings:
        print("no recording runs on this machine")


def _lines(listed: Listed) -> list[str]:
    from datetime import datetime

    from dds_trace.base.units import counted

    from .running import State

    entry = listed.entry
    since = datetime.fromtimestamp(entry.began_ns // 10**9).astimezone().isoformat(" ")
    files = f", {counted(entry.files, 'file')}" if entry.files > 1 else ""
    middleware = entry.rmw or entry.backend
    first = f"{entry.role}  domain {entry.domain_id}  {middleware}  pid {entry.pid}  "
    lines = [f"{first}{counted(entry.messages, 'message')}{files}", f"    since {since}, into {entry.path}"]
    if listed.state is State.KILLED:
        lines[0] = f"killed: {lines[0]}"
        waits = f"its last events are in the ring: dds-trace recover {shlex.quote(str(listed.waiting))}"
        lines.append(f"    {waits if listed.waiting else 'no events are left to recover'}")
    elif listed.state is State.UNSEEN:
        lines.append(f"    process {entry.pid} is not visible from here; it may run in a container")
    if entry.stopped is not None and listed.state is not State.KILLED:
        lines.append(f"    waiting for disk space: {entry.stopped}")
    return lines

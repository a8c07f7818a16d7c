"""What a middleware process really uses, read back from the kernel: a setting that was asked for is a wish.

Linux alone. The way: `asked` says what the options and the user's configuration
ask for, `read_applied` reads what the process does (`sockets` over netlink, `memory` and `libraries` from its maps,
`counters` from `/proc`), `carried` tells which path carried the payload, `differences` compares. `vendors` is the one
table of what each middleware leaves behind and what a transport means for it.

Who uses it: `recorder.roles.read_back` reads before a role's first message and behind its last one, never between messages
(one read costs some milliseconds), and puts `asked`, `applied` and `not_applied` into the session; a ping that gets no echo
looks whether a setting explains it. The analyzer never sees this room: of `not_applied` it makes the finding of that
name, of the own sockets' drops and of the counters it makes others (docs/trace-format.md).
"""

from __future__ import annotations

from .applied import Applied, Snapshot, read_applied, read_snapshot
from .asked import Asked, asked_settings
from .carried import Traffic, payload_path, with_path
from .differences import Difference, Setting, differences

__all__ = [
    "Applied",
    "Asked",
    "Difference",
    "Setting",
    "Snapshot",
    "Traffic",
    "asked_settings",
    "differences",
    "payload_path",
    "read_applied",
    "read_snapshot",
    "with_path",
]

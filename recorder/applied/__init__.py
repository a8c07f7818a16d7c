"""What a middleware process really uses, read back from the kernel (Linux only), to compare with what was requested.

`asked` lists what the options and the user's configuration request; `applied` reads what the process does (`sockets`
over netlink, `memory` from its maps, `counters` from `/proc`); `carried` finds the path of the payload; `differences`
compares. `vendors` is the one table of middlewares. `roles` reads before the first message and after the last one, never
between messages. The result is in the session (docs/trace-format.md), from which the analyzer makes findings.
"""

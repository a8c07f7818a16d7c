"""The ends of a run: messages that were due and never left, and messages that were on their way when the ping died."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dds_trace.base.units import SECOND_NS

from ..model.unsent import MOST_MESSAGES
from .pair import MISSING, first_replies

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dds_trace.tracefile.format.descriptions import Run
    from dds_trace.tracefile.format.events import EventColumns

    from .pair import Published


_PATIENCE_NS = 2 * SECOND_NS
"""Time that a reply may take in a run without any: what a ping waits at its end before it gives one up."""


def count_unsent(run: Run, published: Published, t2: EventColumns) -> int:
    """Return the number of counted messages whose T0 had passed when the run ended and that were never published.

    The run ended when its ping stopped sending (`ended_ns` of the run); if it did not tell, at the last T1 or T2. A message
    that was on its way when the ping died was published. Messages of a live topic have no plan: those that the ping
    skipped never left.
    """
    skipped = run.extra.get("skipped_messages")
    if isinstance(skipped, int):
        return min(max(skipped, 0), MOST_MESSAGES)
    if not len(published) or run.rate_hz <= 0 or str(run.extra.get("data_source", "")).startswith("topic:"):
        return 0
    first, scheduled_ns = int(published.sequence[0]), int(published.scheduled_ns[0])
    if scheduled_ns == MISSING:
        return 0
    told = run.extra.get("ended_ns")
    ended_ns = told if isinstance(told, int) else _last_ns(published, t2)
    planned = run.warmup_messages + run.planned_messages
    due = first + 1 + int((ended_ns - scheduled_ns) * run.rate_hz / SECOND_NS)
    left = max(int(published.sequence[-1]) + 1, run.published, run.warmup_messages)
    return min(max(0, min(due, planned) - left), MOST_MESSAGES)


def settled(run: Run, published: Published, t2: EventColumns) -> NDArray[np.bool_]:
    """Return for each counted message whether its fate is known.

    A ping that was killed cannot tell whether the replies to its last messages would have come: a message without a reply
    is in flight where less time is left before the last T1 or T2 than the slowest reply of the run took. So is always the
    last one: its T1 is kept before it leaves, and the ping may have died in between.
    """
    known = np.ones(len(published), np.bool_)
    if run.state == "finished" or not len(published):
        return known
    receive_ns = first_replies(published, t2)
    replied = receive_ns != MISSING
    rtts_ns = receive_ns[replied] - published.publish_ns[replied]
    longest_ns = int(rtts_ns.max()) if len(rtts_ns) else _PATIENCE_NS
    known &= replied | (published.publish_ns <= _last_ns(published, t2) - longest_ns)
    known[-1] = replied[-1]
    return known


def _last_ns(published: Published, t2: EventColumns) -> int:
    last_ns = int(published.publish_ns.max())
    return max(last_ns, int(t2.monotonic_ns.max())) if len(t2) else last_ns

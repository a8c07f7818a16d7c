"""The end of a run: messages due but never sent, and messages in flight when the ping died."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dds_trace.base.units import SECOND_NS
from dds_trace.tracefile.format.descriptions import Run
from dds_trace.tracefile.format.events import EventColumns

from ..model.unsent import MOST_MESSAGES
from .pair import MISSING, Published, first_replies

_PATIENCE_NS = 2 * SECOND_NS
"""Time that a reply may take in a run without any: a ping's wait at its end."""


def count_unsent(run: Run, published: Published, t2: EventColumns) -> int:
    """Return the number of counted messages that were due when the run ended and never published.

    The run ended at its `ended_ns`, else at the last T1 or T2. A live topic has no plan: its skipped messages were never sent.
    """
    skipped = run.extra.get("skipped_messages")
    if isinstance(skipped, int):
        return min(max(skipped, 0), MOST_MESSAGES)
    if not len(published) or run.rate_hz <= 0 or str(run.extra.get("data_source", "")).startswith("topic:"):
        return 0
    first, scheduled_ns = int(published.sequence[0]), int(published.scheduled_ns[0])
    if scheduled_ns == MISSING:
        return 0
    run_end = run.extra.get("ended_ns")
    ended_ns = run_end if isinstance(run_end, int) else _last_ns(published, t2)
    planned = run.warmup_messages + run.planned_messages
    due = first + 1 + int((ended_ns - scheduled_ns) * run.rate_hz / SECOND_NS)
    left = max(int(published.sequence[-1]) + 1, run.published, run.warmup_messages)
    return min(max(0, min(due, planned) - left), MOST_MESSAGES)


def settled(run: Run, published: Published, t2: EventColumns) -> NDArray[np.bool_]:
    """Return for each counted message whether its fate is known.

    In the run of a killed ping, a message without a reply is in flight if the slowest reply took more time than is left before
    the last T1 or T2. So is the last message: the ping may have died between its T1 and sending it.
    """
    is_settled = np.ones(len(published), np.bool_)
    if run.state == "finished" or not len(published):
        return is_settled
    receive_ns = first_replies(published, t2)
    replied = receive_ns != MISSING
    rtts_ns = receive_ns[replied] - published.publish_ns[replied]
    longest_ns = int(rtts_ns.max()) if len(rtts_ns) else _PATIENCE_NS
    is_settled &= replied | (published.publish_ns <= _last_ns(published, t2) - longest_ns)
    is_settled[-1] = replied[-1]
    return is_settled


def _last_ns(published: Published, t2: EventColumns) -> int:
    last_ns = int(published.publish_ns.max())
    return max(last_ns, int(t2.monotonic_ns.max())) if len(t2) else last_ns

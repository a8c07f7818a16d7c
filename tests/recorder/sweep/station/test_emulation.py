from __future__ import annotations

import pytest

from dds_trace.recorder.sweep.plan.link import PRESETS, Link
from dds_trace.recorder.sweep.station.emulation import queue_disciplines


def test_token_bucket_saves_up_as_little_as_timers_allow():
    slow, fast = Link(rate_mbit_s=54), Link(rate_mbit_s=1000, queue_ms=20)
    words = "root handle 1: tbf rate {} burst {} latency {}"
    for link, shown in (
        (slow, ("54mbit", "3028b", "100ms")),
        (fast, ("1000mbit", "25000b", "20ms")),  # 0.2 ms of 1 Gbit/s are 25,000 bytes
    ):
        assert queue_disciplines(link, kernel_does_all=True) == [words.format(*shown).split()]


def test_netem_is_below_the_token_bucket_if_there_is_one():
    link = Link(rate_mbit_s=54, delay_ms=1, jitter_ms=0.5, loss_percent=0.1)
    netem = [
        "handle",
        "10:",
        "netem",
        "delay",
        "1ms",
        "0.5ms",
        "distribution",
        "normal",
        "loss",
        "0.1%",
        "limit",
        "50000",
    ]
    assert queue_disciplines(link, kernel_does_all=True)[1] == ["parent", "1:1", *netem]
    delay = Link(delay_ms=1, jitter_ms=0.5, loss_percent=0.1)
    assert queue_disciplines(delay, kernel_does_all=True) == [["root", *netem]]


@pytest.mark.parametrize("link", PRESETS.values(), ids=str)
def test_forwarder_leaves_only_the_rate_to_the_kernel(link):
    assert len(queue_disciplines(link, kernel_does_all=False)) == 1

from __future__ import annotations

import pytest

from dds_trace.recorder.sweep.plan.link import PRESETS, Link
from dds_trace.recorder.sweep.station.emulation import queue_disciplines


def test_token_bucket_saves_up_as_little_as_timers_allow():
    slow, fast = Link(rate_mbit_s=54), Link(rate_mbit_s=1000, queue_ms=20)
    assert queue_disciplines(slow, kernel_does_all=True) == [
        ["root", "handle", "1:", "tbf", "rate", "54mbit", "burst", "3028b", "latency", "100ms"],
    ]
    # 0.2 ms of 1 Gbit/s are 25,000 bytes
    assert queue_disciplines(fast, kernel_does_all=True) == [
        ["root", "handle", "1:", "tbf", "rate", "1000mbit", "burst", "25000b", "latency", "20ms"],
    ]


def test_netem_stands_below_the_token_bucket_or_alone():
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
    alone = Link(delay_ms=1, jitter_ms=0.5, loss_percent=0.1)
    assert queue_disciplines(alone, kernel_does_all=True) == [["root", *netem]]


@pytest.mark.parametrize("link", PRESETS.values(), ids=str)
def test_forwarder_leaves_the_kernel_the_rate_alone(link):
    assert len(queue_disciplines(link, kernel_does_all=False)) == 1

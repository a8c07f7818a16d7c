from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from dds_trace.base.errors import OptionError
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Serialization
from dds_trace.recorder.options import PingOptions, RecordOptions
from dds_trace.recorder.payloads import IMU, header_data_type
from dds_trace.recorder.roles.plan import plan_run
from dds_trace.tracefile.writing.destination import TraceDestination

MADE = IMU.make(None, 1)
RECORDED = dataclasses.replace(MADE, rate_hz=30.0, source="bag:x#/imu")


def planned(payload=MADE, duration_s=None, serialization=Serialization.RAW, **asked):
    options = RecordOptions(
        TraceDestination(Path("x.mcap")), NodeOptions(), serialization=serialization, duration_s=duration_s
    )
    return plan_run(options, PingOptions(**asked), payload, session_id=0xAB, seed=4)


@pytest.mark.parametrize(
    ("payload", "asked", "rate_hz", "messages"),
    [
        (MADE, {}, 10.0, 1000),
        (RECORDED, {}, 30.0, 1000),
        (RECORDED, {"rate_hz": 7.0}, 7.0, 1000),
        (MADE, {"duration_s": 10, "rate_hz": 50}, 50, 490),
        (RECORDED, {"duration_s": 10}, 30.0, 290),
        (MADE, {"duration_s": 10, "messages": 5}, 10.0, 5),
        (MADE, {"duration_s": 0.1, "rate_hz": 1}, 1, 1),
    ],
)
def test_rate_and_count(payload, asked, rate_hz, messages):
    plan = planned(payload, **asked)
    assert (plan.rate_hz, plan.messages) == (rate_hz, messages)


def test_the_trace_says_where_the_data_is_from():
    assert planned().extra == {"session_id": "00000000000000ab", "seed": 4, "settings": {}}
    assert planned(RECORDED).extra == {"session_id": "00000000000000ab", "data_source": "bag:x#/imu", "settings": {}}
    assert planned(bridge="builtin", bridge_running=True).extra["bridge_running"] is True


def test_data_that_cannot_be_sent_is_refused():
    live = dataclasses.replace(RECORDED, feed=object())
    with pytest.raises(OptionError, match="--rate cannot be given with topic:/NAME"):
        planned(live, rate_hz=5.0)
    other = dataclasses.replace(MADE, data_type=header_data_type("sensor_msgs/msg/PointCloud2"))
    with pytest.raises(OptionError, match="--serialization typed: sensor_msgs/msg/PointCloud2"):
        planned(other, serialization=Serialization.TYPED)

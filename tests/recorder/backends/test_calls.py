from importlib.util import find_spec

import pytest
from backend_pairs import ROOMY
from processes import ping, relay

from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import OptionError
from dds_trace.recorder.backends import load_backend
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Call, WhenFull
from dds_trace.recorder.options import PingOptions, check_call
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

MESSAGES, WARMUP = 12, 2
PACKAGES = {"ros2": ("rclpy", "test_msgs"), "zenoh": ("zenoh",)}


@pytest.mark.keeps(2)
@pytest.mark.middleware
@pytest.mark.parametrize(
    ("backend", "call", "more", "size", "back"),
    [
        ("ros2", "service", ("--size", "33KB", "--clients", 2), 33_000, 33_000),
        ("ros2", "service", ("--transport", "large-data", "--size", "33KB"), 33_000, 33_000),
        ("ros2", "action", ("--response-size", "2KB"), 4, 2000),
        ("ros2", "action", ("--transport", "large-data", "--response-size", "2KB"), 4, 2000),
        ("zenoh", "service", ("--size", "33KB", "--response-size", "1KB", "--clients", 2), 33_000, 1000),
    ],
)
def test_a_call_is_paired_as_a_message(tmp_path, domain_id, backend, call, more, size, back):
    if not all(map(find_spec, PACKAGES[backend])):
        pytest.skip(f"{PACKAGES[backend]} are not all installed")
    common = ("--backend", backend, "--call", call, "--no-own-cost", *ROOMY)
    for_both = more[: more.index("--clients")] if "--clients" in more else more
    served = tuple(word for word in for_both if word not in ("--size", "33KB"))
    with relay(domain_id, tmp_path / "relay.mcap", *common, *served) as command:
        done = ping(
            *(domain_id, tmp_path / "ping.mcap", *common, *more, "--rate", 40, "--call-timeout", 60),
            *("--messages", MESSAGES, "--warmup", WARMUP),
        )
        assert done.status == 0, done.stderr
        command.stop()
    trace, other = read_trace(tmp_path / "ping.mcap"), read_trace(tmp_path / "relay.mcap")
    for stage in (Stage.T1, Stage.T3, Stage.T4, Stage.T2):
        events = (trace if stage in (Stage.T1, Stage.T2) else other).events[stage]
        assert sorted(events.sequence.tolist()) == list(range(MESSAGES + WARMUP))
        assert set(events.payload_bytes.tolist()) == {back if stage is Stage.T2 else size}
    (run,) = trace.runs
    assert run.extra["call"]["first_ns"] > 0
    assert run.extra["call"]["timed_out"] == 0
    assert run.serialization == ("typed" if backend == "ros2" else "raw")
    assert ("typed_ns" in run.extra["call"]) is (backend == "ros2")
    assert {"accepted_p50_ns", "feedback_p50_ns"} <= run.extra["call"].keys() or call == "service"
    analysis = analyze(tmp_path)
    (group,) = analysis.summary.to_dicts()
    assert group["received"] == MESSAGES
    assert f"call={call}" in group["setting"]
    assert "relay." not in group["setting"]
    assert {"calls"} == {finding.code for finding in analysis.findings} & {
        "calls",
        "calls_timed_out",
        "reply_size",
        "strangers",
    }


@pytest.mark.parametrize(
    ("call", "values"),
    [
        (Call.NONE, (None, {"clients": 2}, ())),
        (Call.NONE, (100, {}, ())),
        (Call.SERVICE, (None, {"bridge": "builtin"}, ())),
        (Call.SERVICE, (None, {}, ("camera",))),
        (Call.ACTION, (None, {"size_bytes": 33_000}, ())),
        (Call.SERVICE, (None, {"rate_hz": float("inf")}, ())),
    ],
)
def test_a_call_that_cannot_be_made_is_one_line(sentences, call, values):
    with pytest.raises(OptionError) as refused:
        check_call(NodeOptions(call=call, response_bytes=values[0]), PingOptions(**values[1]), values[2])
    sentences(str(refused.value))


@pytest.mark.parametrize(
    ("backend", "options"),
    [
        ("cyclonedds", NodeOptions(call=Call.SERVICE)),
        ("zenoh", NodeOptions(call=Call.ACTION)),
        ("zenoh", NodeOptions(call=Call.SERVICE, when_full=WhenFull.DROP)),
    ],
)
def test_a_backend_without_these_calls_says_so(sentences, backend, options):
    with pytest.raises(OptionError) as refused:
        load_backend(backend).check(options)
    sentences(str(refused.value))

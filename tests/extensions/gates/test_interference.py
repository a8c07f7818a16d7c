from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest
from roundtrip_frames import MS, S, roundtrips, rows_by_group

from dds_trace.analyzer.findings.surroundings import disturbed_flows, slowed_results
from dds_trace.analyzer.model.detail_frames import Overtaking
from dds_trace.analyzer.model.setting import flows_of
from dds_trace.extensions.gates.costs import Sent, caught_after, find_head_of_line, find_interference

CAMERA = {"payload_bytes": 1_000_000, "rate_hz": 20.0}
IMU = {"payload_bytes": 296, "rate_hz": 100.0, "data_type": "imu"}
RUNS = (1, 2, 3, 4, 5)


def run_of(flow, other, number, *, period_ns, rtt_of, message):
    """Two seconds of a flow; `rtt_of` is the round trip of a message that leaves at a time."""
    times = range(0, 2 * S, period_ns)
    setting = f"flow={flow},flows=2,with={other}" if other else f"flow={flow}"
    run_id = 1000 * number + sum(map(ord, flow + other))
    rows = [
        {
            "publish_ns": time,
            "relay_in_ns": None if rtt_of(time) is None else time + rtt_of(time) // 2,
            "relay_out_ns": None if rtt_of(time) is None else time + rtt_of(time) // 2,
            "receive_ns": None if rtt_of(time) is None else time + rtt_of(time),
        }
        for time in times
    ]
    return roundtrips(rows, run_id=run_id, setting=setting, **message), run_id


def campaign(*, camera_rtt, imu_with):
    """Five repeats of the camera and the IMU alone and together; the frames by group, and the repeat of each run."""
    parts, passes = [], {}
    for number in RUNS:
        for flow, other, rtt_of, message, period_ns in (
            ("camera", "", camera_rtt, CAMERA, 50 * MS),
            ("imu", "", lambda _, more=number * MS // 100: MS + more, IMU, 10 * MS),
            ("camera", "imu", camera_rtt, CAMERA, 50 * MS),
            ("imu", "camera", lambda time, more=number * MS // 100: imu_with(time) + more, IMU, 10 * MS),
        ):
            rows, run_id = run_of(flow, other, number, period_ns=period_ns, rtt_of=rtt_of, message=message)
            parts.append(rows)
            passes[run_id] = number
    return rows_by_group(pl.concat(parts)), passes


def stalled(time):
    """A camera message of 10 ms, and every tenth one, each half second, of 100 ms."""
    return 100 * MS if time % (500 * MS) == 0 else 10 * MS


def held_up(time):
    """An IMU message that returns with the camera's, if that is under way, else after a millisecond."""
    latest = time // (50 * MS) * (50 * MS)
    return max(MS, *(ahead + stalled(ahead) - time for ahead in (latest, max(latest - 50 * MS, 0))))


def test_a_stall_of_100_ms_in_the_large_flow_is_found_in_the_small_one():
    rows, passes = campaign(camera_rtt=stalled, imu_with=held_up)
    found = find_interference(rows, passes).filter(flow="imu", statistic="p99")
    (row,) = found.to_dicts()
    assert row["verdict"] == "worse"
    # Half of the round trip, as the latency is: up to 100 ms less the time in the relay.
    assert row["new_ns"] == pytest.approx(50 * MS, rel=0.1)
    assert row["base_ns"] == pytest.approx(0.5 * MS, rel=0.1)
    assert (row["with_flows"], row["received_difference"]) == ("camera", 0.0)
    (line,) = find_head_of_line(rows, passes).filter(flow="imu").to_dicts()
    assert line["verdict"] == Overtaking.WAITS.value
    assert (line["other"], line["overtook"], line["runs"]) == ("camera", 0, len(RUNS))
    assert line["caught"] >= 20


def test_flows_on_links_apart_show_none():
    rows, passes = campaign(camera_rtt=stalled, imu_with=lambda _: MS)
    found = find_interference(rows, passes)
    assert "worse" not in set(found["verdict"])
    assert set(found.filter(flow="imu")["verdict"]) == {"same"}
    assert "worse" not in set(found["received_verdict"])
    (line,) = find_head_of_line(rows, passes).filter(flow="imu").to_dicts()
    assert line["verdict"] == Overtaking.OVERTAKES.value
    assert line["overtook_ratio"] == 1.0


def test_messages_that_are_lost_beside_another_flow_are_counted():
    rows, passes = campaign(camera_rtt=stalled, imu_with=lambda _: MS)
    frame = rows.load().with_columns(
        pl.when((pl.col("setting") == "flow=imu,flows=2,with=camera") & (pl.col("sequence") % 4 == 0))
        .then(pl.lit("lost_outbound"))
        .otherwise("outcome")
        .alias("outcome")
    )
    found = find_interference(rows_by_group(frame), passes).filter(flow="imu")
    assert found["received_difference"].to_list() == pytest.approx([-0.25, -0.25])
    assert set(found["received_verdict"]) == {"worse"}


def test_a_flow_without_its_time_alone_has_no_row():
    rows, passes = campaign(camera_rtt=stalled, imu_with=held_up)
    frame = rows.load().filter(pl.col("setting") != "flow=imu")
    assert set(find_interference(rows_by_group(frame), passes)["flow"]) == {"camera"}
    assert set(find_head_of_line(rows_by_group(frame), passes)["flow"]) == {"camera"}


def test_caught_is_who_leaves_while_the_message_ahead_stays_for_twice_the_usual_time():
    ahead = Sent(np.array([0.0, 100.0, 200.0]), np.array([50.0, 150.0, np.inf]))
    own = Sent(np.array([-5.0, 10.0, 45.0, 60.0, 110.0, 210.0]), np.array([0.0, 15.0, 48.0, 65.0, 160.0, 215.0]))
    caught = caught_after(own, ahead, usual_ns=5.0)
    # 10 has 40 left and returns first; 45 has only 5 left; at 60 nothing is under way; 110 waits; the third is lost.
    assert caught.overtook.tolist() == [True, False]
    assert caught.rtt_ns.tolist() == [5.0, 50.0]


def test_a_setting_names_its_flow_and_those_beside_it():
    assert flows_of("flow=imu,flows=3,transport=udp,with=camera+odom") == ("imu", ("camera", "odom"))
    assert flows_of("transport=udp") == ("", ())


def test_a_load_is_compared_with_the_same_without_it(sentences):
    parts, passes = [], {}
    for number in RUNS:
        for load, usual_ns in (("none", MS), ("cpu", 3 * MS), ("memory", MS)):
            rtt_ns = usual_ns + number * MS // 100
            rows, run_id = run_of("imu", load, number, period_ns=10 * MS, rtt_of=lambda _, rtt=rtt_ns: rtt, message=IMU)
            setting = "tuned=true" if load == "none" else f"load={load},tuned=true"
            parts.append(rows.with_columns(pl.lit(setting).alias("setting")))
            passes[run_id] = number
    found = find_interference(rows_by_group(pl.concat(parts)), passes).filter(statistic="p50").sort("with_flows")
    assert found["with_flows"].to_list() == ["load=cpu", "load=memory"]
    assert set(found["flow"]) == {""}
    assert found["verdict"].to_list() == ["worse", "same"]
    assert found["ratio"].to_list() == pytest.approx([3, 1], rel=0.05)
    evidence = SimpleNamespace(
        details=SimpleNamespace(interference=found),
        result=lambda group, words, effect: (group, words, round(effect, 1)),
    )
    assert list(disturbed_flows.observe(evidence)) == []
    ((group, words, effect),) = slowed_results.observe(evidence)
    assert (group, effect) == (found["group"][0], 0.7)
    sentences(words)

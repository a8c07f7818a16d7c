import pytest
from card_bags import START_NS, timer, write
from tap_traces import FAR_NS, LAPTOP, MS, NEAR_NS, ROBOT, Hearing, arrivals, camera, write_beacon, write_tap
from typer.testing import CliRunner

from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import OptionError
from dds_trace.base.units import format_duration, format_rate
from dds_trace.extensions.bags.analyze import analyze_topics
from dds_trace.extensions.bags.limits import judge_tap, judge_topics
from dds_trace.extensions.bags.report import COLUMNS, cells
from dds_trace.extensions.gates.command import app
from dds_trace.extensions.gates.compare import CompareOptions, compare
from dds_trace.extensions.gates.gate import Against, GateOutcome, parse_gate
from dds_trace.extensions.gates.gates import judge_gates, options_for
from dds_trace.extensions.gates.limits_file import read_limits, topic_limits_text, write_limits

SECONDS = 40


def record(folder, *, recordings=1, way_ns=FAR_NS, lost=(), beacon=True):
    for number in range(recordings):
        published = camera(seconds=SECONDS)
        near = Hearing(published, arrivals(published, NEAR_NS, seed=20 + number))
        far = Hearing(published, arrivals(published, way_ns, lost=lost, seed=40 + number))
        write_tap(folder / f"robot{number}.mcap", ROBOT, [near], session_id=0x100 + number)
        write_tap(folder / f"laptop{number}.mcap", LAPTOP, [far], session_id=0x200 + number)
    if beacon:
        write_beacon(folder, LAPTOP, ROBOT, seconds=SECONDS + 3)
    return folder


@pytest.fixture(scope="module")
def one_recording(tmp_path_factory):
    return record(tmp_path_factory.mktemp("one"), lost=[5, 500, 501])


def outcomes(base, new, *texts):
    gates = [parse_gate(text) for text in texts]
    results = judge_gates(compare(base, new, options_for(gates, CompareOptions())), gates)
    return {(result.gate.text, "relay_device=laptop" in result.subject): result for result in results}


@pytest.mark.parametrize(
    ("text", "topic", "metric", "statistic", "against", "limit"),
    [
        ("age_p99(/camera/image) > 50ms", "/camera/image", "age", "p99", Against.NEW, 50 * MS),
        ("one_way_p99.9( /tf ) > +10%", "/tf", "one_way", "p99_9", Against.RATIO, 1.1),
        ("received_ratio(/camera/*) < 99%", "/camera/*", "received_ratio", "", Against.NEW, 0.99),
        ("age_mean > 1s", "", "age", "mean", Against.NEW, 1000 * MS),
        ("latency_p50 > +10%", "", "latency", "p50", Against.RATIO, 1.1),
    ],
)
def test_gates_are_read(text, topic, metric, statistic, against, limit):
    gate = parse_gate(text)
    assert (gate.topic, gate.metric, gate.statistic, gate.against) == (topic, metric, statistic, against)
    assert gate.limit == pytest.approx(limit)


@pytest.mark.parametrize(
    "text", ["latency_p99(/camera) > 1ms", "age_p99(camera) > 1ms", "age_p99( > 1ms", "age(/tf) > 1ms"]
)
def test_gates_that_make_no_sense_are_refused(text):
    with pytest.raises(OptionError, match="--fail-if"):
        parse_gate(text)


@pytest.mark.parametrize(
    ("device", "limits", "code"),
    [
        ("laptop", 'rate = "> 29 Hz"\nmissing = "< 1 %"', 0),
        ("laptop", 'rate = "> 31 Hz"', 20),
        ("laptop", 'missing = "< 0.1 %"', 20),
        ("laptop", 'hole = "< 1 s"', 21),  # a tap's counts do not say
        ("laptop", 'age_p99 = "< 50 ms"', 21),  # its clock is two seconds behind that of the stamps
        ("robot", 'age_p99 = "< 50 ms"', 0),
        ("robot", 'age_p50 = "< 2 ms"', 20),
    ],
)
def test_a_tap_is_judged_at_its_end_by_a_file_of_limits(one_recording, tmp_path, device, limits, code, capsys):
    (tmp_path / "limits.toml").write_text(f'[thresholds."/camera/*"]\n{limits}\n')
    gates = read_limits(tmp_path / "limits.toml", of_recording=True)
    assert judge_tap(one_recording / f"{device}0.mcap", gates) == code
    assert capsys.readouterr().err.count("/camera/image") == limits.count("=")


def test_limits_written_from_a_good_bag_judge_a_tap_and_a_sweep(one_recording, tmp_path):
    """With patterns; a sweep has ages of topics, and no rates."""
    frames = [(START_NS + n * 33 * MS, START_NS + n * 33 * MS - 8 * MS) for n in range(300)]
    good = analyze_topics(write(tmp_path / "good.mcap", {"/camera/image": frames, "/camera/info": frames}))
    file = tmp_path / "limits.toml"
    write_limits(topic_limits_text(good.topics).replace("/camera/i", "/camera/[i]"), file)
    gates = read_limits(file, of_recording=True)
    topics = [f"/camera/[i]{name}" for name in ("mage", "nfo")]
    assert {(gate.results[0][1], gate.name) for gate in gates} == {
        (topic, metric) for topic in topics for metric in ("rate", "missing", "age_p99")
    }
    tap = one_recording / "robot0.mcap"
    assert judge_tap(tap, gates) == 20  # it has to hear /camera/info too
    assert judge_tap(tap, [gate for gate in gates if gate.results[0][1] == topics[0]]) == 0
    assert {gate.name for gate in read_limits(file)} == {"age_p99"}


def test_limits_of_one_recording(one_recording):
    analysis = analyze(one_recording)
    found = outcomes(
        analysis,
        analysis,
        "age_p99(/camera/image) > 50ms",
        "age_p50(/camera/image) > 3ms",
        "received_ratio(/camera/image) < 90%",
        "latency_p50 > 100ms",
    )
    by_gate = {text: result.outcome for (text, over), result in found.items() if over or "latency" in text}
    assert by_gate == {
        "age_p99(/camera/image) > 50ms": GateOutcome.PASSED,
        "age_p50(/camera/image) > 3ms": GateOutcome.REGRESSED,
        "received_ratio(/camera/image) < 90%": GateOutcome.PASSED,
        "latency_p50 > 100ms": GateOutcome.INCONCLUSIVE,  # one run of the beacon
    }


def test_the_bound_of_the_clocks_is_part_of_the_interval(one_recording):
    analysis = analyze(one_recording)
    (row,) = analysis.topics.filter(relay_device="laptop").iter_rows(named=True)
    limit_us = (row["one_way_p50_ns"] + row["bound_ns"] // 2) // 1000
    results = outcomes(analysis, analysis, f"one_way_p50(/camera/image) > {limit_us}us")
    (gate,) = [result for (_, over), result in results.items() if over]
    assert gate.outcome is GateOutcome.INCONCLUSIVE
    assert gate.high - gate.low >= 2 * row["bound_ns"]


def test_a_topic_that_no_tap_heard_is_not_passed(one_recording, tmp_path):
    analysis = analyze(one_recording)
    path = tmp_path / "limits.toml"
    path.write_text("".join(f'[thresholds."{topic}"]\nage_p99 = "< 50 ms"\n' for topic in ("/lidar", "/camera/*")))
    named = [parse_gate("age_p99(/lidar) > 50ms")], GateOutcome.INCONCLUSIVE
    for gates, outcome in (named, (read_limits(path), GateOutcome.REGRESSED)):
        result, *_ = judge_gates(compare(analysis, analysis, options_for(gates, CompareOptions())), gates)
        assert (result.subject, result.outcome) == ("/lidar", outcome)
        assert "/camera/image" in result.reason
    assert judge_tap(one_recording / "robot0.mcap", read_limits(path, of_recording=True)) == 20


def test_changes_between_recordings(tmp_path):
    base = analyze(record(tmp_path / "base", recordings=3))
    slower = analyze(record(tmp_path / "new", recordings=3, way_ns=3 * FAR_NS))
    found = outcomes(base, slower, "one_way_p50(/camera/image) > +50%", "age_p50(/camera/image) > +20%")
    assert {over: result.outcome for (text, over), result in found.items() if "one_way" in text} == {
        True: GateOutcome.REGRESSED,
        False: GateOutcome.PASSED,  # on the robot itself nothing changed
    }
    comparison = compare(base, slower)
    verdicts = comparison.rows.filter(metric="one_way", statistic="p50").sort("relay_device")["verdict"].to_list()
    assert verdicts[0] == "worse"
    assert verdicts[1] in {"same", "inconclusive"}
    assert set(comparison.rows["metric"].unique()) == {"latency", "rtt", "one_way", "age"}


def test_one_recording_a_side_is_no_verdict(tmp_path, one_recording):
    slower = analyze(record(tmp_path / "new", way_ns=3 * FAR_NS))
    comparison = compare(analyze(one_recording), slower)
    assert set(comparison.rows["verdict"]) == {"inconclusive"}


def test_the_command_writes_them_as_junit(one_recording):
    gates = ["--fail-if", "age_p99(/camera/image) > 50ms", "--fail-if", "one_way_p50(/camera/image) > 100us"]
    result = CliRunner().invoke(app, [str(one_recording), *gates, "--report", "junit"])
    assert result.exit_code == 20, result.output
    assert "/camera/image" in result.output
    assert result.output.count("<failure") == 1
    for report in ("md", "json", "html", "github", "badge", "terminal"):
        assert CliRunner().invoke(app, [str(one_recording), *gates[:2], "--report", report]).exit_code == 0, report


def test_only_taps_can_be_judged(tmp_path):
    folder = record(tmp_path, beacon=False)
    result = CliRunner().invoke(app, [str(folder), "--fail-if", "received_ratio(/camera/image) < 90%"])
    assert result.exit_code == 0, result.output
    result = CliRunner().invoke(app, [str(folder), "--fail-if", "age_p50(/camera/image) > 3ms", "--strict"])
    assert result.exit_code == 21, result.output


def test_a_gate_judges_the_number_of_the_table(tmp_path):
    steady, burst = {"/camera": timer(20, 30, without=[(10, 12)])}, [(START_NS + n * MS // 2, 0) for n in range(10)]
    report = analyze_topics(write(tmp_path / "drive.mcap", steady | {"/imu": timer(100, 30), "/rosout": burst}))
    (limits := tmp_path / "limits.toml").write_text(
        "[thresholds.'/*']\nrate = '> 1 Hz'\nmissing = '< 99 %'\njitter = '< 10 s'\n"
    )
    judged = [*judge_topics(report.topics, report.holes, read_limits(limits, of_recording=True))]
    for row, strip in zip(report.topics.rows(named=True), report.strips, strict=True):
        shown = dict(zip(COLUMNS, cells(row, strip), strict=True))
        rate, missing, jitter = (topic.result.value for topic in judged if topic.where == row["topic"])
        assert (format_rate(rate), format_duration(jitter)) == (shown["Rate"], shown["Jitter"])
        assert shown["Missing"] in {"0", "-"} or f"({missing:.1%})".replace("%", " %") in shown["Missing"]

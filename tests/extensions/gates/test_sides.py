import pytest
from campaigns import write_run
from trace_files import Message, evenly, ping_session, relay_session, run, write_pair
from wording import comparison_as

from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.gates.compare import compare
from dds_trace.extensions.gates.gate import parse_gate
from dds_trace.extensions.gates.gates import judge_gates
from dds_trace.extensions.gates.info import comparison_info
from dds_trace.extensions.gates.sides import (
    Recorder,
    difference_sentences,
    environment_differences,
    environment_of_group,
    recorded_apart,
    side_names,
)

OLD, NEWER = '"6.1"', '"6.6"'


def ping(device="pi", kernel="6.1", link="wired", **host):
    return ping_session(device=device, connectivity=link, host={"kernel": kernel, **host})


def relay(device="robot", kernel="6.1", link="wired"):
    return relay_session(device=device, connectivity=link, host={"kernel": kernel})


def group(ping_device="pi", relay_device="robot", link="wired"):
    return {
        "vendor": ping().vendor,
        "relay_vendor": relay().vendor,
        "ping_device": ping_device,
        "relay_device": relay_device,
        "connectivity": link,
    }


def pings_at(*seconds):
    return [ping_session(wall_anchor_ns=second * 1_000_000_000) for second in seconds]


def test_sides_that_were_not_recorded_in_turns_are_told(sentences):
    early, late = pings_at(1, 2), pings_at(3, 4)
    assert recorded_apart(early, late).startswith("the base was recorded before")
    assert recorded_apart(late, early).startswith("the new side was recorded before")
    sentences(recorded_apart(early, late), recorded_apart(late, early))
    assert recorded_apart(pings_at(1, 4), pings_at(2, 3)) == ""
    assert recorded_apart([], pings_at(2, 3)) == ""


def test_the_order_of_the_sides_stands_in_the_notes(tmp_path):
    for name, second in (("base", 1), ("new", 100)):
        (tmp_path / name).mkdir()
        messages = [Message(n, n * 100, n * 100, n * 100 + 10, n * 100 + 20, n * 100 + 30) for n in range(10)]
        write_pair(tmp_path / name, messages, ping=ping_session(wall_anchor_ns=second * 1_000_000_000))
    found = compare(analyze(tmp_path / "base", details=False), analyze(tmp_path / "new", details=False))
    assert "Order: the base was recorded before" in comparison_as("md", comparison_info(found))


def test_two_devices_that_change_places_are_not_alike():
    """Over both devices each side has both kernels: pooled, nothing would differ."""
    base = [ping("a", "6.1"), ping("b", "6.6")]
    new = [ping("a", "6.6"), ping("b", "6.1")]
    found = environment_differences(base, new)
    assert {
        recorder.device: [(one.field, set(one.base), set(one.new)) for one in unlike]
        for recorder, unlike in found.items()
    } == {"a": [("kernel", {OLD}, {NEWER})], "b": [("kernel", {NEWER}, {OLD})]}
    assert len(difference_sentences(found)) == 2


def test_a_device_is_compared_over_one_link_at_a_time():
    base = [ping(link="wired", kernel="6.1"), ping(link="wireless", kernel="6.6")]
    new = [ping(link="wired", kernel="6.1"), ping(link="wireless", kernel="6.1")]
    found = environment_differences([*base, relay()], [*new, relay()])
    assert [recorder.connectivity for recorder, unlike in found.items() if unlike] == ["wireless"]
    assert environment_of_group(group(link="wired"), found) == "same"
    assert environment_of_group(group(link="wireless"), found) == "unlike: ping kernel"


def test_what_was_asked_for_and_what_one_side_does_not_know_is_no_difference():
    base = ping(middleware={"tuned": "true"}, wifi={"wlan0": 1}, governor="performance")
    new = ping(middleware={"tuned": "false"}, wifi={"wlan0": 2})
    ((recorder, unlike),) = environment_differences([base], [new]).items()
    assert recorder == Recorder("ping", base.vendor, "pi", "wired")
    assert unlike == []


def test_a_device_that_replaced_the_only_one_is_held_against_it():
    found = environment_differences([ping("old")], [ping("spare", "6.6")], {"ping_device": "old"})
    assert difference_sentences(found) == (
        f"kernel differs (ping of {ping().vendor} on old, wired): base {OLD}, new {NEWER}.",
    )


@pytest.mark.parametrize("unknown", [{"ping_device": "other"}, {"relay_device": None}])
def test_without_a_fingerprint_of_both_roles_nothing_is_said(unknown):
    sessions = [ping(), relay()]
    found = environment_differences(sessions, sessions)
    assert environment_of_group(group(), found) == "same"
    assert environment_of_group(group(**unknown), found) == "unknown"


@pytest.mark.parametrize(
    ("base", "new", "names"),
    [
        ({"rclpy": "7.1.6", "fastrtps": "2.14.5"}, {"rclpy": "9.1.2", "fastdds": "3.2.3"}, ("fastdds 2.14.5", "fastdds 3.2.3")),
        ({"rclpy": "7.1.6", "fastdds": "3.2.3"}, {"rclpy": "7.1.7", "fastdds": "3.2.3"}, ("rclpy 7.1.6", "rclpy 7.1.7")),
        ({"fastdds": "3.2.3"}, {"fastdds": "3.2.3"}, None),
        ({}, {}, None),
    ],
)  # fmt: skip
def test_sides_are_named_by_the_version_in_which_they_differ(base, new, names):
    before, after = ([ping(versions=versions)] for versions in (base, new))
    assert side_names(environment_differences(before, after)) == names


def record(folder, first, kernel):
    for number in range(first, first + 3):
        messages = evenly((400_000 + s for s in range(30)), start_ns=number * 10_000_000_000, relay_ns=10_000)
        hosts = {"ping": {"host": {"kernel": kernel}}, "relay": {"host": {"kernel": "6.1"}}}
        write_run(folder / str(number), number, messages, **hosts)


def test_the_tables_say_of_each_group_in_what_its_environments_differ(tmp_path):
    record(tmp_path / "base", 1, "6.1")
    record(tmp_path / "new", 11, "6.6")
    found = compare(*(analyze(tmp_path / side, details=False) for side in ("base", "new")))
    assert found.delivery["environment"].to_list() == ["unlike: ping kernel"]
    text = comparison_as("md", comparison_info(found), shows_all=True)
    row = next(line for line in text.splitlines() if line.startswith("| Binary"))
    assert ", unlike: ping kernel |" in row
    assert "Unlike environments: kernel differs (ping of" in text


CALM = {"busy": 40.0, "ours": 60.0}


def record_on(folder, numbers, way_ns, *, busy, ours, mhz=2000.0, temperature_c=50.0, **labels):
    """Runs of a machine with two processors; `busy` is percent of both, `ours` of one for each process."""
    host = {"cpu_percent": busy, "cpu_mhz": mhz, "temperature_c": temperature_c}
    sample = {"host": host, "processes": {"self": {"cpu_percent": ours}}}
    for number in numbers:
        messages = evenly((way_ns + s for s in range(200)), start_ns=number * 10**9)
        start = {"device": "pc", "host": {"cpu_cores": 2}, "wall_anchor_ns": number * 10**12}
        described = {
            "run_id": number,
            "planned_messages": 200,
            "published": 200,
            "extra": {"session_id": f"{number:x}"},
            "labels": labels,
        }
        ping, relay = ping_session(session_id=number, **start), relay_session(session_id=1000 + number, **start)
        write_pair(folder / str(number), messages, ping=ping, relay=relay, runs=[run(**described)], host=[sample] * 4)


@pytest.mark.parametrize(
    ("base", "new", "slower", "outcome"),
    [
        (CALM, CALM, 1.0, "passed"),
        (CALM, CALM, 1.5, "regressed"),
        (CALM, {"busy": 80.0, "ours": 60.0}, 1.5, "inconclusive"),
        ({"busy": 80.0, "ours": 60.0}, CALM, 1.0, "inconclusive"),
        (CALM, {**CALM, "mhz": 1500.0, "temperature_c": 85.0}, 1.5, "inconclusive"),
        (CALM, {"busy": 80.0, "ours": 140.0}, 1.5, "regressed"),  # it takes the processor itself
        (CALM, {"busy": 95.0, "ours": 140.0}, 1.5, "regressed"),  # and others take more, too
        (CALM, {**CALM, "mhz": 1500.0}, 1.5, "regressed"),  # it sleeps: the clock falls, and nothing gets hotter
    ],
)
def test_a_side_on_a_busier_machine_is_not_judged_and_a_slower_change_never_excused(
    tmp_path, base, new, slower, outcome
):
    record_on(tmp_path / "base", (1, 2, 3), 400_000, **base)
    record_on(tmp_path / "new", (11, 12, 13), int(400_000 * slower), **new)
    found = compare(*(analyze(tmp_path / side, details=False) for side in ("base", "new")))
    results = judge_gates(found, [parse_gate("latency_p50 > +10%")])
    assert [result.outcome.value for result in results] == [outcome]
    info = comparison_info(found, results)
    words = {"passed": "the same", "regressed": "slower", "inconclusive": "undecided"}
    assert [group.verdict for group in info.groups] == [words[outcome]]
    assert any("record again" in note for note in info.notes) == (outcome == "inconclusive")
    assert info.said.startswith("Slower") == (outcome == "regressed")


@pytest.mark.parametrize(("busy", "left_out"), [((80, 40, 40), [1]), ((80, 80, 40), []), ((40, 40, 40), [])])
def test_an_interleaved_repeat_on_a_busier_machine_is_not_judged_where_most_are_on_equal_ones(tmp_path, busy, left_out):
    for repeat, percent in enumerate(busy, 1):
        label = {"pass": str(repeat)}
        record_on(tmp_path / "base", [2 * repeat], 400_000, **CALM, cell="a", **label)
        new = {**CALM, "busy": float(percent)}
        record_on(tmp_path / "new", [2 * repeat + 1], 400_000, **new, cell="b", against="a", **label)
    found = compare(*(analyze(tmp_path / side, details=False) for side in ("base", "new")))
    assert [(one.cell, one.repeat) for one in found.left_out] == [("a", repeat) for repeat in left_out]
    assert found.delivery["base_runs"].to_list() == found.delivery["new_runs"].to_list() == [3 - len(left_out)]
    notes = [note for note in comparison_info(found).notes if note.startswith("Without a verdict: repeat 1 of a: ")]
    assert len(notes) == len(left_out)

"""The bookkeeping of a sweep, with a stand-in for `dds-record` that does as its script says."""

import errno
import json
import os
import signal
import threading
import time
from collections import Counter
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import pytest
from sweep_desk import COMMAND, FIRST, FOURTH, MESSAGES, PLAN, SECOND, THIRD, TWO_RELAYS, Heard, files_of

import dds_trace.extensions.campaigns.run.runner as runner_module
from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import OptionError, OutputError, TraceFormatError
from dds_trace.extensions.campaigns import sweep as sweep_module
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.run.state import Status
from dds_trace.extensions.campaigns.search import RateAnswer
from dds_trace.extensions.campaigns.station.programs import Program
from dds_trace.extensions.campaigns.station.station import open_station
from dds_trace.extensions.campaigns.sweep import run_search, run_sweep
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace


def test_one_trace_for_each_device_and_cell(desk):
    outcome = desk.sweep(TWO_RELAYS)
    assert outcome.missing == {}
    assert outcome.cells == 4
    assert desk.traces == files_of(FIRST, SECOND, THIRD, FOURTH)
    # one relay for both rates, another for the other reliability
    assert desk.started == {FIRST: 1, SECOND: 1, THIRD: 1, FOURTH: 1, "relay": 2}
    assert desk.heard.relays == ["ros2", "ros2 best_effort"]


def test_relay_file_holds_the_cells_own_run_and_the_relays_session(desk):
    desk.sweep()
    ping = read_trace(desk.folder / "runs/plan" / f"{FIRST}.ping.mcap")
    relay = read_trace(desk.folder / "runs/plan" / f"{FIRST}.relay.mcap")
    for stage in (Stage.T3, Stage.T4):
        assert relay.events[stage].run_id.tolist() == [ping.runs[0].run_id] * 5
        assert relay.events[stage].sequence.tolist() == [0, 1, 2, 3, 4]
    assert relay.events[Stage.T3].monotonic_ns.tolist() == [40_000 + 1_000_000 * n for n in range(5)]
    assert [session.role for session in relay.sessions] == ["relay"]
    assert relay.sessions[0].relay_id == 0xBEEF


def test_result_is_what_the_timeline_says(desk):
    desk.script(**{FIRST: ["loses"]})
    desk.sweep()
    result = desk.state(FIRST).result
    # Warm-up is message 0; of 1..4 the last is lost; round trips are 0.2, 0.3, 0.4 ms
    assert (result.planned, result.published, result.received) == (4, 4, 3)
    assert result.rtt_ms["p50"] == 0.3
    assert result.achieved_rate_hz == 1000.0
    assert not result.cut_off


def test_commands_have_what_the_cell_asks_for(desk):
    desk.sweep(PLAN.replace("[100, 200]", "200") + 'reliability = "best_effort"\n')
    arguments = {start["cell"]: start["arguments"] for start in desk.starts}
    ping, relay = arguments[FOURTH], arguments["relay"]
    for option, value in {
        "--role": "ping",
        "--domain": "10",
        "--rate": "200",
        "--reliability": "best_effort",
        "--messages": "4",
        "--warmup": "1",
        "--discovery": "localhost",
        "--connectivity": "loopback",
    }.items():
        assert ping[ping.index(option) + 1] == value
    assert relay[:4] == ["--role", "relay", "--domain", "10"]
    assert not {"--rate", "--messages", "--label", "--wait"} & set(relay)


def test_second_call_records_nothing_again(desk):
    desk.sweep()
    before = desk.started
    outcome = desk.sweep()
    assert outcome.missing == {}
    assert desk.started == before
    assert desk.heard.begun == (2, 2)


def test_more_cells_in_the_plan_are_recorded_and_no_others(desk):
    desk.sweep()
    outcome = desk.sweep(PLAN.replace("[100, 200]", "[100, 200, 300]"))
    assert outcome.missing == {}
    assert desk.started["ros2_same_binary_300Hz"] == 1
    assert desk.started[FIRST] == 1


def test_other_settings_need_another_folder(desk):
    desk.sweep()
    with pytest.raises(OptionError, match="other \\[run\\]"):
        desk.sweep(PLAN.replace("messages = 4", "messages = 5"))
    assert "messages = 4" in (desk.folder / "runs/plan/plan.toml").read_text()


def test_cell_that_fails_once_is_tried_again(desk):
    desk.script(**{SECOND: ["fail"]})
    assert desk.sweep().missing == {}
    assert desk.started[SECOND] == 2
    assert (SECOND, "failed: no echo; saw: nobody", False) in desk.heard.ended_cells
    assert desk.state(SECOND).attempts == 2
    assert desk.traces == files_of(FIRST, SECOND)


def test_cell_that_goes_on_failing_is_marked_with_the_reason_and_tried_when_called_again(desk):
    desk.script(**{SECOND: ["fail", "half"]})
    outcome = desk.sweep()
    assert list(outcome.missing) == [SECOND]
    assert "the run was not finished" in outcome.missing[SECOND]
    assert desk.state(SECOND).status is Status.FAILED
    assert desk.traces == files_of(FIRST)
    assert desk.sweep().missing == {}
    assert desk.started == {FIRST: 1, SECOND: 3, "relay": 3}


def test_relay_that_cannot_run_here_fails_its_cells_at_once(desk, sentences):
    desk.script(relay=["unavailable"], **{FIRST: ["slow"]})
    outcome = desk.sweep()
    sentences(*(f"{name}: {reason}" for name, reason in outcome.missing.items()))
    assert desk.started == {FIRST: 1, "relay": 1}
    assert desk.traces == []


@pytest.mark.parametrize(
    ("relay", "first", "starts", "relays", "reason"),
    [
        (["die"], ["slow"], 2, 2, ""),
        ([], ["loses"], 1, 2, ""),  # the next cell has a relay of its own
        ([], ["silent"], 1, 2, ""),  # silence of a relay that still runs is the cell's loss
        ([], ["unavailable"], 1, 1, "the middleware of this cell is not installed"),  # not tried again
        ([], ["bridge dies"] * 2, 2, 3, "the bridge builtin was killed by signal 9 (SIGKILL)"),
    ],
    ids=["a relay that dies", "a loss", "silence", "what cannot run here", "a bridge that dies each time"],
)
def test_trouble_of_one_cell(desk, relay, first, starts, relays, reason):
    desk.script(relay=relay, **{FIRST: first})
    assert desk.sweep().missing == ({FIRST: reason} if reason else {})
    assert desk.started == {FIRST: starts, SECOND: 1, "relay": relays}
    assert desk.traces == (files_of(SECOND) if reason else files_of(FIRST, SECOND))


def test_cells_whose_relay_part_is_lost_are_not_complete(desk):
    desk.script(relay=["lossy"])
    outcome = desk.sweep()
    assert outcome.missing == dict.fromkeys((FIRST, SECOND), "its relay trace is lost")
    assert all(name.endswith(".ping.mcap") for name in desk.traces)
    assert len(desk.traces) == 2
    assert desk.sweep().missing == {}
    assert desk.traces == files_of(FIRST, SECOND)


def test_replies_of_another_relay_in_the_domain_are_not_taken(desk, monkeypatch):
    monkeypatch.setenv("STAND_IN_RELAY", "00000001")
    missing = desk.sweep().missing
    assert list(missing) == [FIRST, SECOND]
    assert all(reason.startswith("another relay answered (0000beef)") for reason in missing.values())
    assert desk.started == {FIRST: 2, SECOND: 2, "relay": 4}
    assert desk.traces == []
    monkeypatch.delenv("STAND_IN_RELAY")
    assert desk.sweep().missing == {}
    assert desk.traces == files_of(FIRST, SECOND)


def test_another_relay_beside_ours_is_told_and_splits_no_result(desk):
    desk.script(**{FIRST: ["both"]})
    assert desk.sweep().missing == {}
    assert len([note for note in desk.heard.notes if "another relay answered (0000dead)" in note]) == 1
    analysis = analyze(desk.folder / "runs", details=False)
    assert analysis.summary["received"].to_list() == [2 * MESSAGES]
    assert "0000dead are left out" in next(f.what for f in analysis.findings if f.code == "unrequested_relay")


def test_full_disk_ends_the_sweep_and_the_next_one_goes_on_with_the_relays_trace(desk, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr(os, "pwritev", full)  # in this process the relay's files alone are written so
        with pytest.raises(OutputError, match="the disk is full"):
            desk.sweep()
    assert desk.state(FIRST).status is Status.RECORDED
    assert desk.sweep().missing == {}
    assert desk.started == {FIRST: 1, SECOND: 1, "relay": 1}
    assert desk.traces == files_of(FIRST, SECOND)


@pytest.mark.parametrize(("run", "allowance_s"), [("slow", -19.0), ("late", 3600.0)], ids=["no message", "begun"])
def test_run_that_takes_too_long_is_cut_off_and_says_how_far_it_got(desk, monkeypatch, run, allowance_s):
    monkeypatch.setattr(runner_module, "START_ALLOWANCE_S", allowance_s)  # 20 s more until an echo
    desk.script(**{FIRST: [run]})
    desk.sweep()
    heard = {name: outcome for name, outcome, _ in desk.heard.ended_cells}
    assert "cut off after 2 of 4" in heard[FIRST]


def test_a_recording_that_does_not_end_is_killed_and_the_sweep_goes_on(desk, monkeypatch):
    monkeypatch.setattr(runner_module, "START_ALLOWANCE_S", -19.0)
    monkeypatch.setattr(Program.stop, "__defaults__", (0.2,))
    desk.script(**{FIRST: ["hangs", "hangs"]})
    reason = desk.sweep().missing[FIRST]
    assert "longer than its plan allows" in reason
    assert "SIGKILL" in reason
    assert desk.state(FIRST).reason == reason
    assert desk.state(SECOND).status is Status.COMPLETE


@pytest.mark.middleware
def test_a_real_recording_that_stands_still_is_killed_and_the_sweep_goes_on(tmp_path, monkeypatch, domain_id):
    # The first one, which never begins, has a second: 20 s until an echo, and 30 s behind its end, less this.
    monkeypatch.setattr(runner_module, "START_ALLOWANCE_S", -49.0)
    started = []

    def start(*arguments, **named):
        started.append(Program(*arguments, **named))
        if len(started) == 1:
            started[0]._process.send_signal(signal.SIGSTOP)
            started[0].stop = partial(started[0].stop, 1.0)
            monkeypatch.setattr(runner_module, "START_ALLOWANCE_S", 0.0)
        return started[-1]

    monkeypatch.setattr(runner_module, "Program", start)
    run = f"messages = 20\nattempts = 1\nsettle_seconds = 0\ncutoff_seconds = 30\ndomain = {domain_id}"
    plan = parse_plan(f'[run]\n{run}\n[axes]\nbackend = "socket"\nrate = [20, 40]\n', "plan", "plan.toml")
    (reason,) = run_sweep(plan, tmp_path, Heard()).missing.values()
    assert "SIGKILL" in reason


def test_search_of_the_highest_rate_goes_on_where_it_was_interrupted(desk):
    plan = parse_plan(
        "[run]\nmessages = 4\nsettle_seconds = 0\n"
        "[search]\nmin_rate = 100\nmax_rate = 900\nloss_percent = 30\nresolution = 2\nknee_repeats = 1\n",
        "plan",
        "plan.toml",
    )
    for _ in range(2):
        folder, (found,) = run_search(plan, desk.folder / "runs", Heard(), command=COMMAND)
        assert (found.answer, found.cell.rate, found.held_repeats) == (RateAnswer.AT_LEAST, 900.0, (1, 1))
        assert folder == desk.folder / "runs" / "plan-max-rate"
    # 300 and 520 on the way, then the highest; nothing again the second time but the relay
    assert desk.started == {"ros2_same_binary_300Hz": 1, "ros2_same_binary_520Hz": 1, "ros2_same_binary_900Hz": 1} | {
        "relay": 1
    }


def test_second_sweep_in_the_same_folder_is_refused(desk, monkeypatch):
    from dds_trace.extensions.campaigns import folder as sweep_folder

    monkeypatch.setattr(sweep_folder, "LOCK_PATIENCE_S", 0.0)
    heard = []
    with (
        sweep_folder.locked_folder(desk.folder / "runs" / "plan", heard.append),
        pytest.raises(OptionError, match="in use by another sweep"),
    ):
        desk.sweep()
    assert heard == []
    assert "is in use" in desk.heard.notes[0]


def test_interruption_keeps_what_is_complete_and_goes_on_from_there(desk):
    desk.script(**{SECOND: ["slow"]})
    ended = threading.Event()

    def press_ctrl_c():
        while not (desk.stand_in / f"waiting-{SECOND}").exists():
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)
        # One that meets a destructor or a callback of the garbage collector is printed and lost, as Python's
        # documentation says of exceptions there; a person presses again.
        while not ended.wait(60) and (desk.stand_in / f"waiting-{SECOND}").exists():
            os.kill(os.getpid(), signal.SIGINT)

    handler = signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever ran before in this process
    presser = threading.Thread(target=press_ctrl_c)
    presser.start()
    try:
        with pytest.raises(KeyboardInterrupt):
            desk.sweep()
    finally:
        ended.set()
        presser.join()
        signal.signal(signal.SIGINT, handler)
    assert desk.traces == files_of(FIRST)
    assert desk.state(FIRST).status is Status.COMPLETE
    assert desk.state(SECOND).status is Status.RUNNING
    assert desk.sweep().missing == {}
    assert desk.traces == files_of(FIRST, SECOND)
    assert desk.started == {FIRST: 1, SECOND: 2, "relay": 2}


@pytest.fixture
def link(monkeypatch):
    measured = {"monotonic_ns": 0, "link": {"rate_mbit_s": 54}, "ping": {"sent_bytes": 5 * 33_000}}

    @contextmanager
    def with_link(*arguments, **options):
        with open_station(*arguments, **options) as station:
            yield replace(station, pair=SimpleNamespace(report=lambda: measured))

    monkeypatch.setattr(sweep_module, "open_station", with_link)
    return measured


def test_report_of_the_link_is_in_the_cells_file(desk, link):
    desk.sweep()
    relay = read_trace(desk.folder / "runs/plan" / f"{FIRST}.relay.mcap")
    assert [sample["link"] for sample in relay.host_samples if "link" in sample] == [link["link"]]


def test_messages_that_went_past_the_link_are_no_measurement_of_it(desk, link, sentences):
    link["ping"]["sent_bytes"] = 2000
    sentences(*(f"{name}: {reason}" for name, reason in desk.sweep().missing.items()))
    assert desk.traces == []
    assert len(list((desk.folder / "runs/plan").glob("*.bypassed"))) == 2


def test_messages_that_are_lost_before_the_link_are_a_result(desk, link):
    link["ping"]["sent_bytes"] = 4 * 33_000  # of five, one of which never came back
    desk.script(**{FIRST: ["silent"], SECOND: ["silent"]})
    assert desk.sweep().missing == {}
    assert desk.traces == files_of(FIRST, SECOND)


def test_ping_that_is_killed_says_so_and_is_tried_again(desk):
    desk.script(**{FIRST: ["killed"]})
    assert desk.sweep().missing == {}
    assert (FIRST, "failed: killed by signal 9 (SIGKILL)", False) in desk.heard.ended_cells
    assert desk.started[FIRST] == 2


THREE = PLAN.replace("[100, 200]", "100") + "relays = 3\n"
CELL = "ros2_same_binary_100Hz_relays-3"


def test_each_relay_has_a_trace_of_its_own(desk):
    assert desk.sweep(THREE).missing == {}
    assert desk.started == {CELL: 1, "relay": 3}
    assert desk.traces == sorted([*files_of(CELL), f"{CELL}.relay-2.mcap", f"{CELL}.relay-3.mcap"])
    numbers = [
        words[words.index("--relay-id") + 1] for start in desk.starts if "--relay-id" in (words := start["arguments"])
    ]
    assert sorted(numbers) == ["1", "2", "3"]
    assert desk.state(CELL, THREE).status is Status.COMPLETE


def test_a_relay_that_dies_is_started_again_with_the_others(desk):
    desk.script(**{CELL: ["slow"], "relay": ["relay", "relay", "die"]})
    assert desk.sweep(THREE).missing == {}
    assert desk.started == {CELL: 2, "relay": 6}


def test_a_resumed_sweep_has_nothing_to_do(desk):
    desk.sweep(THREE)
    before = Counter(desk.started)
    assert desk.sweep(THREE).missing == {}
    assert desk.started == before


@pytest.fixture
def target(desk):
    folder = desk.folder / "home"
    folder.mkdir()
    (folder / "thesis.tex").write_text("mine")
    return folder


@pytest.fixture
def sweep_folder(desk):
    folder = desk.folder / "runs/plan"
    folder.mkdir(parents=True)
    return folder


def test_linked_folder_for_parts_is_refused(desk, sweep_folder, target):
    (sweep_folder / ".parts").symlink_to(target)
    with pytest.raises(OutputError, match=r"\.parts is a link"):
        desk.sweep()
    assert [path.name for path in target.iterdir()] == ["thesis.tex"]


def test_foreign_files_among_the_parts_stay_and_are_told(desk, sweep_folder, target):
    parts = sweep_folder / ".parts"
    (parts / "a folder").mkdir(parents=True)
    (parts / "notes.txt").write_text("mine")
    (parts / "recording.mcap").write_text("mine")
    (parts / "1-1700000000000-1.mcap").write_text("left by a killed sweep")
    (parts / f"{FIRST}.ping.mcap").symlink_to(target / "thesis.tex")
    (parts / f"{FIRST}.ping.mcap.log").symlink_to(target / "thesis.tex")
    assert desk.sweep().missing == {}
    assert [name for name in desk.traces if name != "recording.mcap"] == files_of(FIRST, SECOND)
    assert sorted(path.name for path in parts.iterdir()) == ["a folder", "notes.txt", "recording.mcap"]
    assert (target / "thesis.tex").read_text() == "mine"


def test_a_plan_that_was_there_before_the_sweep_stays(desk, sweep_folder):
    (sweep_folder / "plan.toml").write_text("mine")
    desk.sweep()
    assert (sweep_folder / "plan.toml").read_text() == "mine"
    assert any("it stays" in note for note in desk.heard.notes)


def test_folder_in_the_place_of_a_log_is_one_clear_error(desk, sweep_folder):
    (sweep_folder / f".parts/{FIRST}.ping.mcap.log").mkdir(parents=True)
    with pytest.raises(OutputError, match=r"\.log"):
        desk.sweep()


def test_folder_in_the_place_of_a_trace_is_one_clear_error(desk, sweep_folder):
    (sweep_folder / f"{FIRST}.ping.mcap").mkdir()
    with pytest.raises(OutputError, match=f"{FIRST}.ping.mcap"):
        desk.sweep()
    assert (sweep_folder / f"{FIRST}.ping.mcap").is_dir()


def test_linked_lock_is_refused(desk, sweep_folder, target):
    (sweep_folder / ".lock").symlink_to(target / "made.txt")
    with pytest.raises(OutputError):
        desk.sweep()
    assert [path.name for path in target.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("cell", "segment"), [("../../home/thesis", "1-17-1.mcap"), (FIRST, "../../../home/thesis"), (FIRST, "*")]
)
def test_state_that_names_files_outside_is_refused_and_removes_nothing(desk, sweep_folder, target, cell, segment):
    desk.sweep()
    state = json.loads((sweep_folder / "state.json").read_text())
    held = state["cells"].pop(FIRST)
    state["cells"][cell] = {**held, "status": "recorded", "segment": segment}
    (sweep_folder / "state.json").write_text(json.dumps(state))
    (target / "thesis.ping.mcap").write_text("mine")
    before = sorted(desk.folder.rglob("*"))
    with pytest.raises(TraceFormatError, match="not the state of a sweep"):
        desk.sweep()
    assert sorted(desk.folder.rglob("*")) == before

"""The rehearsal of a plan with a stand-in for `dds-record`: what is asked of it, where, and what its refusal means."""

import json
import sys
from pathlib import Path

import pytest
from processes import running

from dds_trace.base.errors import OptionError, OutputError, TraceFormatError
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.rehearsal import rehearse_plan

STAND_IN = """
import json, os, sys
arguments = sys.argv[1:]
with open(os.environ["ASKED"], "a") as file:
    file.write(json.dumps(arguments) + "\\n")
refused = json.loads(os.environ["REFUSED"])
for words, reason in refused:
    if all(word in arguments for word in words):
        print("not the reason", flush=True)
        print(f"dds-record: {reason}", file=sys.stderr)
        sys.exit(7)
"""

PLAN = """
[run]
repeats = 2
order = "alternating"
[axes]
reliability = ["reliable", "best_effort"]
data = ["binary", "string"]
size = ["33KB", "4MB"]
rate = [10, 20]
"""


class Stage:
    def __init__(self, folder, monkeypatch):
        self.folder = folder
        self.program = folder / "stand_in.py"
        self.program.write_text(STAND_IN)
        self.log = folder / "asked.jsonl"
        self.monkeypatch = monkeypatch
        self.checked, self.notes = [], []
        monkeypatch.setenv("ASKED", str(self.log))
        self.refuse()

    def refuse(self, *refused):
        """Refuse what has all words, with the reason: `(["--tuned"], "not here")`."""
        self.monkeypatch.setenv("REFUSED", json.dumps(refused))

    def rehearse(self, text=PLAN, check=None):
        def checking(arguments):
            self.checked.append(arguments)
            if check is not None:
                check(arguments)

        return rehearse_plan(
            parse_plan(text, "plan", "plan.toml"),
            self.folder / "runs" / "plan",
            checking,
            note=self.notes.append,
            command=[sys.executable, "-I", "-S", str(self.program)],
        )

    @property
    def asked(self):
        return [json.loads(line) for line in self.log.read_text().splitlines()] if self.log.exists() else []


@pytest.fixture
def stage(tmp_path, monkeypatch):
    return Stage(tmp_path, monkeypatch)


def test_every_cell_is_checked_and_each_kind_of_relay_and_ping_starts_once(stage):
    assert stage.rehearse() == {}
    roles = [arguments[arguments.index("--role") + 1] for arguments in stage.checked]
    assert (roles.count("relay"), roles.count("ping")) == (2, 16)
    started = [arguments[arguments.index("--role") + 1] for arguments in stage.asked]
    assert started == ["relay", "ping", "ping", "relay", "ping", "ping"]  # sizes and rates are alike
    assert all(arguments[-1] == "--check" for arguments in stage.asked)
    assert not (stage.folder / "runs").exists()


def test_a_refused_kind_of_ping_stands_for_all_its_cells_and_passes(stage):
    stage.refuse((["ping", "string", "best_effort"], "no string today"))
    refused = stage.rehearse()
    assert len(refused) == 2 * 2 * 2
    assert set(refused.values()) == {"no string today"}
    assert all("string" in name and "best_effort" in name for name in refused)
    assert sum(name.endswith("_r2") for name in refused) == 4


def test_a_refused_relay_refuses_its_cells_and_none_of_them_starts(stage):
    stage.refuse((["relay", "best_effort"], "no domain is free"))
    refused = stage.rehearse()
    assert len(refused) == 2 * 2 * 2 * 2
    assert set(refused.values()) == {"its relay: no domain is free"}
    assert not any("ping" in arguments and "best_effort" in arguments for arguments in stage.asked)


def test_refused_arguments_are_a_cells_own(stage):
    def check(arguments):
        if "4000000" in arguments and "--rate" in arguments:
            raise OptionError("--rate 20: too much at this size")

    refused = stage.rehearse(check=check)
    assert len(refused) == 2 * 2 * 2
    assert all("-4MB_20Hz" in name for name in refused)


def test_a_program_that_is_not_there_is_the_reason(stage):
    stage.program.unlink()
    refused = stage.rehearse("[axes]\nrate = [10]\n")
    ((name, reason),) = refused.items()
    assert name == "ros2_same_binary_10Hz"
    assert reason.startswith("its relay: ")


def test_options_of_the_devices_are_rehearsed_too(stage):
    stage.rehearse(
        '[axes]\nrate = [10]\n[devices.ping]\noptions = ["--realtime", "50"]\n'
        '[devices.relay]\noptions = ["--cpu-affinity", "0"]\n'
    )
    relay, ping = stage.asked
    assert (relay[relay.index("--cpu-affinity") + 1], ping[ping.index("--realtime") + 1]) == ("0", "50")


def test_a_live_topic_is_not_waited_for(stage):
    assert stage.rehearse('[axes]\ndata = ["topic:/camera"]\n') == {}
    _, ping = stage.asked
    assert "topic:/camera" not in ping
    assert any("topic:/camera" in arguments for arguments in stage.checked)


def test_an_environment_whose_recorder_knows_no_rehearsal_is_noted_once(stage):
    environment = stage.folder / "older"
    (environment / "bin").mkdir(parents=True)
    program = environment / "bin" / "dds-record"
    program.write_text("#!/bin/sh\necho 'dds-record: No such option: --check' >&2\nexit 2\n")
    program.chmod(0o755)
    assert stage.rehearse(f'[axes]\nenvironment = ["{environment}"]\ndata = ["binary", "imu"]\n') == {}
    assert len(stage.notes) == 1
    assert "has no --check" in stage.notes[0]


def test_a_folder_that_holds_another_sweep_is_refused(stage):
    folder = stage.folder / "runs" / "plan"
    folder.mkdir(parents=True)
    (folder / "state.json").write_text("{}")
    with pytest.raises(TraceFormatError, match="not the state of a sweep"):
        stage.rehearse()


def test_a_folder_that_cannot_be_made_is_refused(stage):
    (stage.folder / "runs").write_text("a file")
    with pytest.raises(OutputError, match=r"runs: not a folder that can be written; give another --out"):
        stage.rehearse()


@pytest.mark.middleware
def test_an_unsupported_package_in_another_environment_is_one_line(tmp_path, sentences):
    """The environment is a stand-in: this one, with the metadata of a version that does not exist ahead of the real one."""
    pytest.importorskip("cyclonedds")
    program = tmp_path / "other" / "bin" / "dds-record"
    metadata = tmp_path / "cyclonedds-12.0.0.dist-info" / "METADATA"
    for path, text in (
        (program, f'#!/bin/sh\nPYTHONPATH={tmp_path} exec {Path(sys.executable).with_name("dds-record")} "$@"\n'),
        (metadata, "Metadata-Version: 2.1\nName: cyclonedds\nVersion: 12.0.0\n"),
        (tmp_path / "plan.toml", f'[axes]\nbackend = "cyclonedds"\nenvironment = "{tmp_path / "other"}"\nrate = 10\n'),
    ):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    program.chmod(0o755)
    with running("dds-trace", "sweep", tmp_path / "plan.toml", "--out", tmp_path / "runs", "--rehearse") as command:
        done = command.finish()
    assert done.status != 0
    assert "Traceback" not in done.stdout + done.stderr
    sentences((done.stdout + done.stderr).splitlines()[-1])

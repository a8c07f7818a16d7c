import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from processes import counts_in
from trace_files import ping_session, run
from typer.testing import CliRunner

from dds_trace.base.errors import BackendUnavailableError, OptionError, OutputError, OutputExistsError, TraceError
from dds_trace.cli import doctor
from dds_trace.cli.record import command
from dds_trace.cli.record.run import describe_progress, print_result
from dds_trace.extensions.bags import recover_command
from dds_trace.extensions.bridges import BRIDGE_MODULES
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.recorder import choices
from dds_trace.recorder.backends import BACKEND_MODULES
from dds_trace.recorder.backends.qos import RANKS
from dds_trace.recorder.choices import Discovery, Serialization, Transport
from dds_trace.recorder.errors import BridgeError, LossesError, StoppedError
from dds_trace.recorder.option import parse_percentage, parse_seconds
from dds_trace.recorder.option_table import OPTIONS, help_of
from dds_trace.recorder.options import DEFAULT_MESSAGES, DEFAULT_WARMUP
from dds_trace.recorder.recording import Recorded
from dds_trace.recorder.roles.floor import RecorderCost
from dds_trace.recorder.roles.progress import PingProgress, RelayProgress
from dds_trace.tracefile.format.descriptions import Qos, Run, Session
from dds_trace.tracefile.writing.destination import ClosedTrace, TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink


@pytest.fixture
def parsed(monkeypatch, tmp_path):
    for name in ("ROS_DOMAIN_ID", "ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        monkeypatch.delenv(name, raising=False)
    seen = []
    monkeypatch.setattr("dds_trace.cli.record.run.record_until_stopped", lambda options, **_: seen.append(options))

    def parse(*arguments, role="ping"):
        result = CliRunner().invoke(
            command.app, ["--role", role, "--out", str(tmp_path / "x.mcap"), *map(str, arguments)]
        )
        if isinstance(result.exception, TraceError):
            raise result.exception
        assert result.exit_code == 0, result.output
        return seen.pop()

    return parse


def test_a_ping_and_a_relay_with_nothing_given(parsed):
    options = parsed()
    assert options.node.domain_id == 10
    assert options.node.discovery is Discovery.SUBNET
    assert options.node.qos == Qos("reliable", "volatile", "keep_last", 10)
    assert options.serialization is Serialization.RAW
    assert options.duration_s is None
    ping = options.ping
    assert (ping.data, ping.size_bytes, ping.rate_hz) == ("binary", None, None)
    assert (ping.messages, ping.warmup, ping.bridge, ping.relay_domain_id) == (None, 10, "none", None)
    options = parsed(role="relay")
    assert (options.ping, options.node.domain_id, options.relay_id) == (None, 10, None)
    assert options.node.qos == parsed().node.qos


def test_a_bridge_has_the_domains_of_the_paper(parsed):
    options = parsed("--bridge", "builtin")
    assert options.node.domain_id == 5
    assert (options.ping.bridge, options.ping.relay_domain_id) == ("builtin", 10)
    options = parsed("--bridge", "builtin", "--domain", 6, "--relay-domain", 7)
    assert (options.node.domain_id, options.ping.relay_domain_id) == (6, 7)


@pytest.mark.parametrize("backend", ["socket", "zenoh"])
def test_a_relay_at_an_address_listens_on_this_machine_unless_asked(parsed, monkeypatch, backend):
    assert parsed("--backend", backend, role="relay").node.discovery is Discovery.LOCALHOST
    asked = parsed("--backend", backend, "--discovery", "subnet", role="relay")
    assert asked.node.discovery is Discovery.SUBNET
    assert parsed("--backend", backend, "--peer", "pi4").node.discovery is Discovery.SUBNET
    assert parsed(role="relay").node.discovery is Discovery.SUBNET  # DDS has no one address
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    assert parsed("--backend", backend, role="relay").node.discovery is Discovery.SUBNET


def test_the_environment_of_ros_counts(parsed, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    assert parsed().node.domain_id == 42
    assert parsed("--domain", 7).node.domain_id == 7
    assert parsed(role="relay").node.discovery is Discovery.LOCALHOST
    assert parsed("--discovery", "subnet").node.discovery is Discovery.SUBNET
    bridged = parsed("--bridge", "builtin")
    assert (bridged.node.domain_id, bridged.ping.relay_domain_id) == (5, 42)
    monkeypatch.setenv("ROS_DOMAIN_ID", "ten")
    with pytest.raises(OptionError, match="ROS_DOMAIN_ID is 'ten'"):
        parsed()
    monkeypatch.setenv("ROS_DOMAIN_ID", "300")
    with pytest.raises(OptionError, match="ROS_DOMAIN_ID 300"):
        parsed(role="tap")


@pytest.mark.parametrize(("text", "seconds"), [("10", 10), ("10s", 10), ("2.5 min", 150), ("500ms", 0.5), ("1h", 3600)])
def test_times_take_units_and_a_bare_number_is_seconds(parsed, text, seconds):
    options = parsed("--duration", text, "--wait", text, "--patience", text)
    assert (options.duration_s, options.ping.wait_s, options.ping.patience_s) == (seconds,) * 3
    with pytest.raises(OptionError, match="--duration '10 parsecs'"):
        parse_seconds("10 parsecs", "--duration")


def test_everything_given(parsed, tmp_path):
    options = parsed(
        *("--data", "string", "--size", "1KiB", "--rate", 100, "--messages", 7, "--warmup", 3, "--wait", 2.5),
        *("--seed", 4, "--reliability", "best_effort", "--durability", "transient_local", "--depth", 5),
        *("--history", "keep_all", "--serialization", "typed", "--executor", "single"),
        *("--device", "pi4", "--connectivity", "wireless", "--label", "room=lab", "--label", "x=a=b"),
        *("--discovery", "localhost", "--duration", 9, "--force"),
        *("--backend", "ros2", "--rmw", "rmw_fastrtps_cpp", "--transport", "udp", "--tuned"),
        *("--cpu-affinity", "0", "--realtime", 10),
    )
    assert options.destination.path == tmp_path / "x.mcap"
    assert options.destination.force
    assert options.node.qos == Qos("best_effort", "transient_local", "keep_all", 5)
    assert options.node.executor.value == "single"
    assert (options.node.rmw, options.node.transport, options.node.tuned) == ("rmw_fastrtps_cpp", Transport.UDP, True)
    assert options.serialization is Serialization.TYPED
    assert (options.cpu_affinity, options.realtime_priority) == ("0", 10)
    assert (options.device, options.connectivity, options.duration_s) == ("pi4", "wireless", 9)
    ping = options.ping
    assert (ping.data, ping.size_bytes, ping.rate_hz) == ("string", 1024, 100)
    assert (ping.messages, ping.warmup, ping.wait_s, ping.seed) == (7, 3, 2.5, 4)
    assert ping.labels == {"room": "lab", "x": "a=b"}


def test_values_of_rarer_options_are_read(parsed):
    assert parsed().destination.mode == 0o640
    assert parsed("--file-mode", "0600", role="relay").destination.mode == 0o600
    assert parsed("--deadline", "20ms").node.qos.extra == {"deadline_ns": 20_000_000}
    assert parsed("--lifespan", "1.5s", role="relay").node.qos.extra == {"lifespan_ns": 1_500_000_000}
    types = "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry"
    assert parsed("--type", types[0], "--type", types[1], role="relay").types == types
    assert parsed("--duration", 9, role="beacon").duration_s == 9
    assert parsed("--duration", 9, "--topics", "/scan", role="tap").duration_s == 9
    ping = parsed("--bridge", "builtin-zenoh", "--bridge-listen", "0.0.0.0:7447", "--fsync").ping
    assert (ping.bridge, ping.bridge_listen, ping.bridge_peers) == ("builtin-zenoh", "0.0.0.0:7447", ())
    ping = parsed("--bridge", "builtin-zenoh", "--bridge-peer", "10.0.0.2:7447").ping
    assert (ping.bridge_listen, ping.bridge_peers) == (None, ("10.0.0.2:7447",))
    assert parsed("--bridge", "builtin", "--bridge-running").ping.bridge_running


@pytest.mark.parametrize(
    ("arguments", "role", "message"),
    [
        (["--size", "3KQ"], "ping", "size '3KQ' is not understood"),
        (["--label", "novalue"], "ping", "-o label 'novalue': write KEY=VALUE"),
        (["--relay-id", "5"], "ping", "--relay-id cannot be given to a ping"),
        (["--type", "a/msg/B"], "ping", "--type cannot be given to a ping"),
        (["--bridge-running"], "relay", "--bridge-running cannot be given to a relay"),
        (["--deadline", "20"], "ping", "-o deadline '20' is not understood"),
        (["--lifespan", "0ms"], "relay", "-o lifespan '0ms' is not understood"),
        (["--rate", "5", "--size", "1"], "relay", "--size, --rate cannot be given to a relay"),
    ],
)
def test_wrong_value_is_refused(parsed, arguments, role, message):
    with pytest.raises(OptionError, match=message):
        parsed(*arguments, role=role)


@pytest.mark.parametrize(
    ("arguments", "role", "message"),
    [
        (["--domain", "233"], "relay", "--domain 233: a DDS domain id must be between 0 and 232"),
        (["--rate", "0"], "ping", "--rate 0"),
        (["--messages", "0"], "ping", "--messages 0"),
        (["--depth", "0"], "relay", "--depth 0"),
        (["--duration", "0"], "relay", "--duration 0"),
        (["--type", "PointCloud2"], "relay", "'PointCloud2' is not a message type"),
        (
            ["--type", "sensor_msgs/msg/PointCloud2", "--serialization", "typed"],
            "relay",
            "-o serialization=typed: sensor_msgs/msg/PointCloud2 is only sent as raw bytes",
        ),
        (["--bridge-running"], "ping", "-o bridge_running, bridge_listen and bridge_peer need --bridge"),
        (["--bridge", "x", "--bridge-running", "--bridge-peer", "a:1"], "ping", "-o bridge_running starts nothing"),
        (["--data", "video"], "ping", "there is no data type 'video'"),
        (["--data", "file:/nowhere"], "ping", "--data file:/nowhere: No such file"),
        (["--data", "bag:/nowhere#/x"], "ping", "--data bag:/nowhere: there is no such file or folder"),
        (["--data", "bag:/nowhere"], "ping", "--data bag:/nowhere: write bag:PATH#TOPIC"),
        (["--data", "file:/nowhere", "--size", "5"], "ping", "--size 5: the messages of file:/nowhere have"),
        (["--data", "topic:/imu_data_relay"], "ping", "--data topic:/imu_data_relay: "),
    ],
)
def test_what_cannot_be_recorded_is_refused_before_anything_is_opened(arguments, role, message, tmp_path, monkeypatch):
    monkeypatch.setattr("dds_trace.recorder.base_recording.open_node", lambda *_: pytest.fail("a node was opened"))
    out = tmp_path / "x.mcap"
    result = CliRunner().invoke(command.app, ["--role", role, "--out", str(out), *arguments])
    assert isinstance(result.exception, OptionError)
    assert str(result.exception).startswith(message)
    assert not out.exists()


@pytest.mark.parametrize("role", ["ping", "relay"])
def test_an_existing_file_is_refused_before_anything_is_opened(role, tmp_path, monkeypatch):
    monkeypatch.setattr("dds_trace.recorder.base_recording.open_node", lambda *_: pytest.fail("a node was opened"))
    out = tmp_path / "x.mcap"
    out.write_text("precious")
    result = CliRunner().invoke(command.app, ["--role", role, "--out", str(out)])
    assert isinstance(result.exception, OutputExistsError)
    assert "--force" in str(result.exception)
    assert out.read_text() == "precious"


def test_without_a_role_nothing_is_recorded(sentences):
    result = CliRunner().invoke(command.app, ["--messages", "5"])
    assert isinstance(result.exception, OptionError)
    sentences(str(result.exception))


def test_a_whole_trace_has_nothing_to_recover_and_one_that_was_cut_off_is_closed_again(tmp_path):
    path = tmp_path / "x.mcap"
    sink = TraceSink(TraceDestination(path), recorded().session)
    for sequence in range(5):
        sink.record(1, 7, sequence, 1000 + sequence)
    sink.close()
    assert "(5 events); nothing to recover" in CliRunner().invoke(recover_command.app, [str(path)]).output
    path.write_bytes(path.read_bytes()[:-200])  # into the summary
    result = CliRunner().invoke(recover_command.app, [str(path)])
    assert result.exit_code == 0, result.output
    assert result.output.startswith("Wrote ")
    assert counts_in(result.output.splitlines()[1])[:2] == [5, 0]  # events in the file, in the ring


def test_the_cost_of_recording_is_printed_without_middleware_too(monkeypatch, tmp_path, sentences):
    cost = RecorderCost(30.0, 500.0, 900.0, 4_000.0, 9_000.0, 3000)
    monkeypatch.setattr(
        "dds_trace.recorder.roles.floor.measure_recorder_cost", lambda folder: cost if folder == tmp_path else None
    )

    def without_middleware(*_):
        raise BackendUnavailableError("no ROS 2 here")

    monkeypatch.setattr("dds_trace.recorder.roles.floor.measure_floor", without_middleware)
    result = CliRunner().invoke(doctor.app, ["--out", str(tmp_path / "x.mcap"), "--json"])
    assert result.exit_code == 0, result.output
    costs = [check for check in json.loads(result.output) if check["part"] == "cost"]
    assert [check["works"] for check in costs] == [True] + [False] * (len(costs) - 1)
    sentences(costs[0]["detail"], costs[-1]["detail"])


@pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("setpriv"), reason="needs root and setpriv")
def test_doctor_permits_nothing_to_the_root_of_a_container():
    ask = "from dds_trace.cli import doctor; print(*(check.works for check in doctor.all_checks(None) if check.part == 'permissions'))"
    withheld = ["setpriv", "--bounding-set=-all", "prlimit", "--rtprio=0", sys.executable, "-c", ask]
    assert subprocess.run(withheld, check=True, capture_output=True, text=True).stdout.split() == ["False"] * 3


@pytest.mark.middleware
def test_doctor_measures_the_floor_of_what_is_installed():
    program = Path(sys.executable).with_name("dds-trace")
    ran = subprocess.run([program, "doctor", "--json"], check=True, capture_output=True)
    assert ran.stderr == b""
    checks = json.loads(ran.stdout)
    floors = {check["name"]: check["works"] for check in checks if check["name"].startswith("floor of")}
    installed = [check for check in checks if check["part"] == "middlewares" and check["works"]]
    assert floors == {check["name"].replace("--backend", "floor of"): True for check in installed}


def test_help_names_every_bridge_backend_and_default_and_the_recorder_ranks_every_reliability_and_durability():
    assert {choice.value for choice in choices.Reliability} == set(RANKS["reliability"])
    assert {choice.value for choice in choices.Durability} <= set(RANKS["durability"])
    output = CliRunner(env={"COLUMNS": "300", "TERMINAL_WIDTH": "300"}).invoke(command.app, ["--help"]).output
    shown = "".join(output.split())  # a line may end after a hyphen
    assert f"Messagestomeasure.Default:{DEFAULT_MESSAGES}," in shown
    assert help_of(OPTIONS["warmup"]).endswith(f"Default: {DEFAULT_WARMUP}")
    assert [name for name in (*BRIDGE_MODULES, *BACKEND_MODULES) if name not in shown] == []


def test_progress_in_words(sentences):
    warming = PingProgress(110, 4, 3, 0, warmup=10, warmup_received=3)
    running = PingProgress(110, 79, 76, 2, warmup=10, warmup_received=9, warmup_lost=1)
    measured = PingProgress(410, 300, 298, 1, 815_000, 1_430_000)
    relays = RelayProgress(7, 2, 0), RelayProgress(7, 2, 1)
    sentences(*map(describe_progress, (warming, running, measured, PingProgress(410, 0, 0, 0), *relays)))


def recorded(error=None):
    session = Session(
        *(1, "ping", "pi4", "ros2", "fastdds", "rmw_fastrtps_cpp", 10, None, "wired"),
        wall_anchor_ns=0,
        monotonic_anchor_ns=0,
    )
    trace = ClosedTrace(Path("x.mcap"), 4, 1, 900, error)
    run = Run(0xAB, "imu", 296, 10.0, 2, 0, published=2)
    return Recorded(trace, session, PingProgress(2, 2, 2, 0, 800_000, 900_000), run)


def test_the_result_in_words_and_as_json(capsys, sentences):
    print_result(recorded(), as_json=False)
    sentences(*capsys.readouterr().out.splitlines())
    print_result(recorded(), as_json=True)
    assert json.loads(capsys.readouterr().out) == {
        "path": "x.mcap",
        "role": "ping",
        "session_id": "0000000000000001",
        "run_id": "00000000000000ab",
        "relay_id": None,
        "events": 4,
        "dropped_events": 1,
        "bytes": 900,
        "error": None,
        "planned": 2,
        "sent": 2,
        "received": 2,
        "lost": 0,
        "rtt_p50_ns": 800_000,
        "rtt_p99_ns": 900_000,
        "warmup": 0,
        "warmup_received": 0,
        "warmup_lost": 0,
    }


def test_a_trace_that_could_not_be_written_whole_and_a_bridge_that_died_are_errors_after_the_counts(capsys):
    with pytest.raises(OutputError, match="disk full"):
        print_result(recorded(OutputError("disk full")), as_json=True)
    assert json.loads(capsys.readouterr().out)["error"] == "disk full"
    ended = replace(recorded(), error=BridgeError("killed by signal 9"))
    with pytest.raises(BridgeError, match="killed by signal 9"):
        print_result(ended, as_json=True)
    told = json.loads(capsys.readouterr().out)
    assert (told["error"], told["events"]) == ("killed by signal 9", 4)


@pytest.mark.parametrize(("lost", "allowed", "fails"), [(1, 0.01, False), (2, 0.01, True), (100, None, False)])
def test_losses_above_the_limit_are_an_error(capsys, lost, allowed, fails):
    ended = replace(recorded(), progress=PingProgress(100, 100, 100 - lost, lost))
    if not fails:
        print_result(ended, as_json=False, fail_if_lost=allowed)
        return
    with pytest.raises(LossesError, match=r"2 of 100 messages lost, 2\.00%; --fail-if-lost allows 1\.00%") as error:
        print_result(ended, as_json=False, fail_if_lost=allowed)
    assert error.value.exit_code == 13
    assert capsys.readouterr().out.startswith("Wrote x.mcap")


def test_events_that_wait_in_the_ring_are_counted_with_the_way_to_get_them():
    ended = recorded(OutputError("x.mcap: cannot write the trace: the disk is full"))
    ended = replace(ended, trace=replace(ended.trace, ring_events=7, path=Path("my x.mcap")))
    with pytest.raises(
        OutputError, match=r"the disk is full; 7 events wait in its ring file: .*`dds-trace recover 'my x\.mcap'`$"
    ):
        print_result(ended, as_json=False)


def test_a_ring_that_was_removed_with_its_folder_is_not_promised(tmp_path):
    folder = tmp_path / "usb"
    sink = TraceSink(TraceDestination(folder / "x.mcap"), ping_session(), clock_ns=lambda: 0)
    shutil.rmtree(folder)
    sink.write_run(run())
    trace = sink.close()
    with pytest.raises(OutputError, match=r"its folder was deleted or moved; record to a folder that stays"):
        print_result(replace(recorded(), trace=trace), as_json=False)
    with pytest.raises(OutputError, match=r"a folder that stays; 9 events went with it$"):
        print_result(replace(recorded(), trace=replace(trace, events=2, ring_events=7)), as_json=False)


def test_without_a_trace_nothing_is_called_written(capsys, sentences):
    for as_json in (False, True):
        with pytest.raises(StoppedError) as stopped:
            print_result(replace(recorded(), trace=None, run=None), as_json=as_json)
    sentences(str(stopped.value))
    assert json.loads(capsys.readouterr().out)["path"] is None


@pytest.mark.parametrize("text", ["1", "x%", "-1%", "101%", "nan%", "inf%", ""])
def test_a_limit_of_losses_is_a_percentage(text):
    with pytest.raises(OptionError, match="write a percentage from 0% to 100%"):
        parse_percentage("--fail-if-lost", text)
    assert parse_percentage("--fail-if-lost", "0.5 %") == 0.005


@pytest.mark.parametrize(("role", "domain"), [("tap", 0), ("beacon", 0), ("relay", 10), ("ping", 10)])
def test_who_joins_a_robot_is_in_its_domain(parsed, monkeypatch, role, domain):
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    words = ["--role", role, *(["--topics", "/camera"] if role == "tap" else [])]
    assert parsed(*words).node.domain_id == domain
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert parsed(*words).node.domain_id == 42
    assert parsed(*words, "--domain", 7).node.domain_id == 7


def test_a_plan_without_a_domain_is_in_that_of_the_environment(monkeypatch):
    plan = "[axes]\nbackend = 'socket'\n[[matrix]]\nsize = '1KB'\n"
    monkeypatch.setenv("ROS_DOMAIN_ID", "89")
    assert parse_plan(plan, "one", "one.toml").run.domain == 89
    assert parse_plan(f"[run]\ndomain = 7\n{plan}", "one", "one.toml").run.domain == 7
    monkeypatch.setenv("ROS_DOMAIN_ID", "no number")
    with pytest.raises(OptionError, match="ROS_DOMAIN_ID"):
        parse_plan(plan, "one", "one.toml")

import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
import stand_in_bridge
from stand_in_bridge import StandInBridge
from waiting import wait_until

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.extensions.bridges import BRIDGE_MODULES
from dds_trace.extensions.bridges.base import BridgeOptions, Halves
from dds_trace.extensions.bridges.guard import LOG_LIMIT_BYTES
from dds_trace.extensions.bridges.running import BridgeState, open_bridge
from dds_trace.recorder.errors import BridgeError


@pytest.fixture
def stand_in(monkeypatch):
    monkeypatch.setitem(BRIDGE_MODULES, "stand-in", "stand_in_bridge")

    def play(part, halves=Halves.NEVER, **settings):
        monkeypatch.setattr(stand_in_bridge, "BRIDGE", StandInBridge(part=part, halves=halves, **settings))
        return open_bridge("stand-in", BridgeOptions(), **({"up_timeout_s": 0.5} if part == "never_up" else {}))

    return play


def family_of(pid):
    return [child.pid for child in psutil.Process(pid).children(recursive=True)]


def gone(pids):
    return not any(psutil.pid_exists(pid) and psutil.Process(pid).status() != "zombie" for pid in pids)


def test_program_serves_until_it_gets_sigint(stand_in):
    with stand_in("serves") as bridge:
        bridge.check()
        assert bridge.state is BridgeState.STARTING
        bridge.mark_ready()
        assert bridge.state is BridgeState.READY
        pid = bridge.processes["bridge"]
        assert psutil.pid_exists(pid)
    assert bridge.state is BridgeState.STOPPED
    assert not psutil.pid_exists(pid)
    (program,) = bridge.describe()["programs"]
    assert program["exit_code"] == 0
    assert program["left_behind"] == 0
    assert program["asked"] is True
    assert program["log_tail"].splitlines() == [stand_in_bridge.UP, "stand-in was told to stop"]


def test_description_names_version_configuration_and_command(stand_in):
    with stand_in("serves") as bridge:
        described = bridge.describe()
    assert described["bridge"] == "stand-in"
    assert (described["ping_domain_id"], described["relay_domain_id"]) == (5, 10)
    (program,) = described["programs"]
    assert program["version"] == "0.1-stand-in"
    assert program["configuration"] == "serves\n"
    assert program["command"][0] == Path(sys.executable).name  # no path of the machine that recorded


def test_sample_holds_memory_and_cpu_of_the_program(stand_in):
    with stand_in("floods") as bridge:
        bridge.sample()
        wait_until(lambda: bridge.sample()["programs"]["bridge"]["cpu_percent"] > 0)
        load = bridge.sample()["programs"]["bridge"]
    assert load["processes"] == 1
    assert load["memory_bytes"] > 1_000_000


def test_no_echo_before_the_end_means_never_ready(stand_in):
    with stand_in("serves") as bridge:
        pass
    assert bridge.state is BridgeState.NEVER_READY


def test_program_that_dies_at_once_is_one_clear_line(stand_in):
    with pytest.raises(BridgeError, match=r"stand-in ended with status 3: stand-in has no configuration"):
        stand_in("dies_at_once").__enter__()


def test_program_that_cannot_be_started_is_one_clear_line(stand_in, tmp_path):
    broken = tmp_path / "ddsrouter"
    broken.write_text("no program at all")
    with pytest.raises(BridgeError, match=r"cannot start .*/ddsrouter: .*Permission denied"):
        stand_in("serves", program=str(broken)).__enter__()


def test_program_that_never_comes_up_is_ended(stand_in):
    with pytest.raises(BridgeError, match=r"the bridge stand-in did not come up within 0.5 s: "):
        stand_in("never_up").__enter__()


def test_program_that_dies_mid_run_keeps_its_last_words(stand_in):
    with stand_in("dies_when_told") as bridge:
        bridge.mark_ready()
        os.kill(bridge.processes["bridge"], signal.SIGUSR1)
        wait_until(lambda: bridge.failure is not None)
        with pytest.raises(BridgeError, match="ended with status 4: stand-in lost its way"):
            bridge.check()
    described = bridge.describe()
    assert described["state"] == "died"
    assert described["programs"][0]["log_tail"].endswith("stand-in lost its way")


def test_program_that_is_killed_says_the_signal(stand_in, sentences):
    with stand_in("serves") as bridge:
        os.kill(bridge.processes["bridge"], signal.SIGKILL)
        wait_until(lambda: bridge.failure is not None)
        sentences(bridge.failure)


def test_log_of_a_flooding_program_is_bounded_on_disk_and_in_the_trace(stand_in):
    with stand_in("floods") as bridge:
        folder = next(Path(part).parent for part in bridge._halves[0].program.command if "/both/" in part)
        older = folder / "log.1"
        wait_until(older.exists)
        written = set()
        # Each holds a quarter of both at least; the newer one is not there for a moment when it becomes the older one.
        wait_until(lambda: written.add(older.stat().st_mtime_ns) or len(written) > 5)
        sizes = []
        for path in folder.glob("log*"):
            with suppress(FileNotFoundError):
                sizes.append(path.stat().st_size)
        assert sum(sizes) <= 2 * LOG_LIMIT_BYTES
    (program,) = bridge.describe()["programs"]
    assert program["log_bytes"] > 2 * LOG_LIMIT_BYTES
    assert len(program["log_tail"]) <= 8192
    assert not folder.exists()


def test_program_that_ignores_signals_is_killed(stand_in, monkeypatch):
    monkeypatch.setattr("dds_trace.extensions.bridges.supervise.STOP_PATIENCE_S", 0.2)
    with stand_in("stubborn") as bridge:
        pid = bridge.processes["bridge"]
    assert not psutil.pid_exists(pid)
    assert bridge.describe()["programs"][0]["exit_code"] == 128 + signal.SIGKILL


def test_children_left_behind_are_ended_and_counted(stand_in, monkeypatch):
    monkeypatch.setattr("dds_trace.extensions.bridges.supervise.STOP_PATIENCE_S", 0.2)
    with stand_in("leaves_children") as bridge:
        pids = [bridge.processes["bridge"], *family_of(bridge.processes["bridge"])]
        assert len(pids) == 3
        assert bridge.sample()["programs"]["bridge"]["processes"] == 3
    assert gone(pids)
    assert bridge.describe()["programs"][0]["left_behind"] == 2


def test_children_of_a_killed_program_are_ended_too(stand_in, monkeypatch):
    monkeypatch.setattr("dds_trace.extensions.bridges.supervise.STOP_PATIENCE_S", 0.2)
    with stand_in("leaves_children") as bridge:
        pids = family_of(bridge.processes["bridge"])
        os.kill(bridge.processes["bridge"], signal.SIGKILL)
        wait_until(lambda: bridge.failure is not None)
        assert gone(pids)


RECORDER = """
import sys
sys.path[:0] = {path!r}
import stand_in_bridge
from dds_trace.extensions.bridges import BRIDGE_MODULES
from dds_trace.extensions.bridges.base import BridgeOptions
from dds_trace.extensions.bridges.running import open_bridge
from dds_trace.extensions.bridges import supervise
supervise.STOP_PATIENCE_S = 0.2
BRIDGE_MODULES["stand-in"] = "stand_in_bridge"
stand_in_bridge.BRIDGE = stand_in_bridge.StandInBridge(part="leaves_children")
with open_bridge("stand-in", BridgeOptions()) as bridge:
    print(bridge._halves[0].program.command[-1], flush=True)
    input()
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_no_process_is_left_when_the_recorder_is_killed(number):
    script = RECORDER.format(path=[str(Path(stand_in_bridge.__file__).parent)])
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as recorder:
        folder = Path(recorder.stdout.readline().strip()).parent
        pids = family_of(recorder.pid)
        assert len(pids) == 4  # guard, program, two children
        recorder.send_signal(number)
    wait_until(lambda: gone(pids))
    wait_until(lambda: not folder.parent.exists())


def test_no_process_is_left_when_the_guard_is_killed(stand_in):
    with stand_in("serves") as bridge:
        pid = bridge.processes["bridge"]
        psutil.Process(pid).parent().kill()
        wait_until(lambda: gone([pid]))
        assert bridge.describe()["state"] == "died"


def test_two_halves_are_two_programs_joined_by_a_link_of_their_own(stand_in):
    with stand_in("serves", halves=Halves.ALWAYS) as bridge:
        assert set(bridge.processes) == {"bridge_ping", "bridge_relay"}
        halves = [program["half"] for program in bridge.describe()["programs"]]
    assert halves == ["ping", "relay"]
    assert bridge.state is BridgeState.NEVER_READY


def test_a_missing_program_is_named_with_how_to_install_it(stand_in):
    with pytest.raises(BackendUnavailableError, match=r"stand-in is not installed; it is a test's own"):
        stand_in("serves", installed=False).__enter__()


def test_an_unknown_bridge_names_the_known_ones():
    with pytest.raises(OptionError, match=re.escape("no bridge 'buildin'; choose one of builtin")):
        open_bridge("buildin", BridgeOptions()).__enter__()


def test_no_file_of_a_bridge_stays_in_the_temporary_folder(stand_in, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with stand_in("serves"):
        assert list(tmp_path.iterdir())
    assert not list(tmp_path.iterdir())


IN_REAL_TIME = """
import os, pathlib, sys
from dds_trace.extensions.bridges.supervise import SupervisedProgram
from dds_trace.recorder.host.process import set_realtime
set_realtime(5)
program = SupervisedProgram(["sleep", "600"], pathlib.Path(sys.argv[1]), os.environ, None)
print(os.sched_getscheduler(0) == os.SCHED_FIFO, os.sched_getscheduler(program.pid) == os.SCHED_OTHER)
program.stop()
"""


def test_a_bridge_of_a_recorder_in_real_time_runs_at_usual_priority(tmp_path):
    done = subprocess.run([sys.executable, "-c", IN_REAL_TIME, tmp_path], capture_output=True, text=True, check=False)
    if "not permitted" in done.stderr:
        pytest.skip("SCHED_FIFO is not permitted here")
    assert done.stdout.split() == ["True", "True"], done.stderr

"""Every role over every transport ends: by itself, by Ctrl-C and by SIGTERM, whatever has happened to the other side.

Each test has three recordings of one role, which end in these three ways, and lasts as long as the one that ends by itself.
`just ends` runs all of it; `just test-all` what starts quickly, and one fault of each other transport; `just test` not those over ROS 2.
"""

import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import psutil
import pytest
from card_bags import TEXT_SCHEMA, write_mcap
from middlewares import needs
from namespaces import needs_namespaces
from processes import run, running
from waiting import wait_until

from dds_trace.base.errors import TraceError
from dds_trace.extensions.campaigns.folder import PARTS as PARTS_FOLDER
from dds_trace.extensions.campaigns.load import loaded
from dds_trace.extensions.campaigns.plan.cells import OutageBy
from dds_trace.extensions.campaigns.station.namespaces import NamespacePair, Side
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.format.ring import ring_path
from dds_trace.tracefile.reading.reader import read_trace

TRANSPORTS = {
    "ros2-udp": ("--backend", "ros2", "--transport", "udp"),
    "ros2-shm": ("--backend", "ros2", "--transport", "shm"),
    "ros2-large-data": ("--backend", "ros2", "--transport", "large-data"),
    "ros2-typed-large-data": ("--backend", "ros2", "--transport", "large-data", "--serialization", "typed"),
    "cyclonedds": ("--backend", "cyclonedds"),
    "zenoh": ("--backend", "zenoh"),
    "socket-tcp": ("--backend", "socket"),
    "socket-udp": ("--backend", "socket", "--transport", "udp", "--reliability", "best_effort"),
}
ROLES = ("ping", "relay", "tap", "beacon", "client", "server")
FAULTS = ("peer stopped", "link down", "busy machine", "peer gone")
STAGES = {
    "ping": Stage.T2,
    "client": Stage.T2,
    "beacon": Stage.T2,
    "relay": Stage.T4,
    "server": Stage.T4,
    "tap": Stage.TAP,
}
"""Role -> the event by which a recording is known to be under way."""
PARTS = {
    "ping": (("relay", False), ("ping", True)),
    "relay": (("ping", False), ("relay", True)),
    "tap": (("relay", False), ("ping", False), ("tap", True)),
    "beacon": (("beacon", False), ("beacon", True)),
}
PARTS |= {"client": PARTS["ping"], "server": PARTS["relay"]}
"""Role -> the recordings to start, and which one is tested."""
LOST, HELD_UP_S, LAST_S = 12, 1.0, 15
"""`LAST_S` after its start a recording ends by itself: by then the silence is long enough to mean a lost relay."""
LARGE = ("--data", "binary", "--rate", "20", "--warmup", "0", "--size")
"""Of such a size that a TCP connection's buffers hold a few seconds of them: with more than the buffers hold sent in both directions
at a time, Fast DDS 2.14 waits for itself (eProsima/Fast-DDS, issue 4203)."""
SIZES = {"ros2-large-data": "50KB", "ros2-typed-large-data": "50KB"}
SMALL = ("--data", "string", "--size", "64B", "--rate", "20", "--warmup", "0")


def has(role: str, transport: str, fault: str) -> bool:
    is_socket, is_call = transport.startswith("socket"), role in ("client", "server")
    if "typed" in transport:
        return role in ("ping", "relay")
    if is_call and not (transport.startswith("ros2") or transport == "zenoh"):
        return False
    return not (role == "tap" and is_socket) and not (fault == "link down" and transport == "ros2-shm")


QUICK = (
    ("ping", "socket-tcp", "peer stopped"),
    ("ping", "ros2-large-data", "peer stopped"),
    ("relay", "socket-tcp", "link down"),
    ("relay", "cyclonedds", "peer gone"),
    ("tap", "ros2-udp", "busy machine"),
    ("beacon", "zenoh", "peer stopped"),
    ("server", "ros2-shm", "peer gone"),
    ("client", "ros2-large-data", "link down"),
)


def cases() -> Iterator[object]:
    for role in ROLES:
        for transport, options in TRANSPORTS.items():
            for fault in FAULTS:
                if not has(role, transport, fault):
                    continue
                is_quick = (role, transport, fault) in QUICK
                network = [needs_namespaces("ip", "iproute2")] if fault == "link down" else []
                slow = [] if is_quick else [pytest.mark.ends, pytest.mark.slow]
                dear = [pytest.mark.thorough] if is_quick and transport.startswith("ros2") else []
                name = f"{role}-{transport}-{fault}".replace(" ", "-")
                yield pytest.param(role, transport, fault, marks=[needs(options[1]), *network, *slow, *dear], id=name)


pytestmark = [pytest.mark.middleware, pytest.mark.timeout(400)]


class Bench:
    def __init__(self, stack, domains, folder: Path, transport: str, pair: NamespacePair | None) -> None:
        self._stack, self._domains, self._folder, self._pair = stack, domains, folder, pair
        discovery = "localhost" if pair is None else "subnet"
        self._options = (*TRANSPORTS[transport], "--discovery", discovery, "--no-own-cost")
        self._has_peers = transport.startswith(("socket", "zenoh"))
        self._response = ("--response-size", "1MB") if transport == "ros2-large-data" else ()
        self._is_small, self._size = transport == "socket-udp", SIZES.get(transport, "500KB")
        self.peers, self.tested, self.outs = [], [], []

    def start(self, role: str, number: int, seconds: int) -> None:
        domain_id, call = self._domains.take(), ("--call", "service") if role in ("client", "server") else ()
        call += self._response if role == "server" else ()
        traffic = SMALL if call or role == "tap" or self._is_small else (*LARGE, self._size)
        listening = None if self._pair is None else self._side(is_tested=role in ("relay", "server")).address
        for part, is_tested in PARTS[role]:
            more = ("--duration", seconds + 5) if is_tested else ()
            if part == "ping":
                more = (*traffic, "--wait", 120, "--messages", 20 * (seconds if is_tested else 600))
            elif part == "tap":
                more = (*more, "--topics", "/string_data*")
            if self._has_peers and part != "relay" and (part, is_tested) != ("beacon", False):
                more = (*more, "--peer", listening or "127.0.0.1")
            out = self._folder / f"{part}-{'tested' if is_tested else 'peer'}-{number}.mcap"
            arguments = ("--role", part, "--domain", domain_id, *self._options, *call, *more, "--out", out)
            prefix = () if self._pair is None else self._side(is_tested=is_tested).prefix
            command = self._stack.enter_context(running("dds-record", *arguments, prefix=prefix))
            if part in ("relay", "beacon"):
                command.wait_for_line("serves" if part == "relay" else "in domain")
            (self.tested if is_tested else self.peers).append(command)
            self.outs += [out] * is_tested

    def inflict(self, fault: str) -> None:
        if self._pair is not None:
            self._pair.cut(OutageBy.LINK)
        elif fault == "busy machine":
            self._stack.enter_context(loaded("cpu"))
        for peer in self.peers:
            if fault == "peer stopped":
                peer.send_signal(signal.SIGSTOP)
            elif fault == "peer gone":
                peer.clean_up()

    def _side(self, *, is_tested: bool) -> Side:
        assert self._pair is not None
        return self._pair.ping if is_tested else self._pair.relay

    def wait_for_messages(self, stage: Stage) -> None:
        for command, out in zip(self.tested, self.outs, strict=True):
            wait_until(lambda command=command, out=out: not command.is_alive or count_events(out, stage) >= 10)
            assert command.is_alive, command.finish()


def count_events(out: Path, stage: Stage) -> int:
    try:
        return len(read_trace(out).events[stage])
    except (TraceError, OSError):  # it has just begun
        return 0


@pytest.mark.parametrize(("role", "transport", "fault"), list(cases()))
def test_it_ends(role, transport, fault, domains, tmp_path):
    with ExitStack() as stack:
        pair = stack.enter_context(NamespacePair(None)) if fault == "link down" else None
        bench = Bench(stack, domains, tmp_path, transport, pair)
        for number, seconds in enumerate((600, 600, LAST_S)):  # the last one ends by itself
            bench.start(role, number, seconds)
            bench.wait_for_messages(STAGES[role])
        bench.inflict(fault)
        *others, by_itself = bench.tested
        ended = {"own end": by_itself.finish()}
        for command, number in zip(others, (signal.SIGINT, signal.SIGTERM), strict=True):
            # On a busy machine it gets no processor for a while.
            for sent in (signal.SIGSTOP, number, signal.SIGCONT) if fault == "busy machine" else (number,):
                if command.is_alive:
                    command.send_signal(sent)
                time.sleep(HELD_UP_S if sent is signal.SIGSTOP else 0)
            ended[number.name] = command.finish()
    code = LOST if role in ("ping", "client") and fault != "busy machine" else 0
    assert {way: done.status for way, done in ended.items()} == dict.fromkeys(ended, code), ended
    for out in bench.outs:
        assert not ring_path(out).exists()
        sessions = read_trace(out).sessions
        assert {session.state for session in sessions} == {"closed"}
        assert code == 0 or "is lost" in str(sessions[-1].extra["error"])


PLAN = "[run]\nmessages = 40\nrepeats = 2\ndiscovery = 'localhost'\nsettle_seconds = 0.1\nping_domain = {0}\ndomain = {0}\n"
PLAN += "[axes]\nbackend = '{1}'\nrate = [20, 10]\nsize = [1000, 9000]\n"
ADVISED = PLAN.replace("localhost", "subnet")
WORDS = {
    "sweep": ("sweep", "plan.toml"),
    "advise": ("advise", "plan.toml"),
    "capacity": ("capacity", "plan.toml"),
    "explain rates": ("explain", "rates", "plan.toml"),
    "explain size": ("explain", "size", "2KB", "plan.toml"),
    "bag": ("bag", "large.mcap", "--report", "html"),
    "recover": ("recover", "large.mcap"),
}
OF_FILES = ("bag", "recover")
WAYS = {signal.SIGINT: 130, signal.SIGTERM: 130, signal.SIGKILL: -signal.SIGKILL}
QUICK_WAYS = (
    ("capacity", signal.SIGTERM),
    ("explain rates", signal.SIGKILL),
    ("recover", signal.SIGKILL),
    ("bag", signal.SIGINT),
)


def write_large(path: Path) -> None:
    data = b"\0\1\0\0\x60\0\0\0" + 96 * b"x"
    messages = ((f"/t{n % 20}", 10**18 + n * 10**6, 10**18 + n * 10**6, data, n) for n in range(60_000))
    write_mcap(path, messages, encoding="cdr", schema=TEXT_SCHEMA)


def left_running(token: str) -> list[str]:
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if process.environ().get("ENDS_TOKEN") == token and process.status() != psutil.STATUS_ZOMBIE:
                found.append(" ".join(process.cmdline()))
    return found


@pytest.mark.parametrize("is_held_up", [False, True], ids=["", "stopped"])
@pytest.mark.parametrize(
    ("name", "number"),
    [
        pytest.param(name, number, marks=[] if (name, number) in QUICK_WAYS else [pytest.mark.ends, pytest.mark.slow])
        for name in WORDS
        for number in WAYS
    ],
)
def test_a_command_that_is_ended_leaves_no_process_and_nothing_half(
    name, number, is_held_up, domains, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    plan = (ADVISED if name == "advise" else PLAN).format(domains.take(), "zenoh" if name == "advise" else "socket")
    (tmp_path / "plan.toml").write_text(plan)
    if name in OF_FILES:
        write_large(tmp_path / "large.mcap")
    out, token = tmp_path / "out", tmp_path.name
    words = (*WORDS[name], "--out", out / "new" if name == "recover" else out)
    environment = {"ENDS_TOKEN": token}

    def is_under_way() -> bool:
        if name in OF_FILES:
            return any(file.path == str(tmp_path / "large.mcap") for file in psutil.Process(command.pid).open_files())
        return any(path.stat().st_size for path in out.rglob("*.mcap"))

    with running("dds-trace", *words, environment=environment) as command:
        wait_until(lambda: not command.is_alive or is_under_way())
        assert command.is_alive, command.finish()
        for sent in (signal.SIGSTOP, number, signal.SIGCONT) if is_held_up else (number,):
            if command.is_alive:
                command.send_signal(sent)
            time.sleep(HELD_UP_S if sent is signal.SIGSTOP else 0)
        done = command.finish()
    expected = -signal.SIGTERM if name in OF_FILES and number == signal.SIGTERM else WAYS[number]
    assert done.status in (expected, 0), done  # it may have been through
    assert "Traceback" not in done.stderr
    wait_until(lambda: not left_running(token))
    for trace in (path for path in out.rglob("*.mcap") if PARTS_FOLDER not in path.parts):
        read_trace(trace)
    if name == "recover" and done.status:  # the same command goes on
        assert run("dds-trace", *words).status == 0

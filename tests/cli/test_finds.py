"""Whole commands on what trials and hypothesis have found: a documented exit code and one line, never a traceback."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
from hostile_values import COMMANDS, check_told, run
from trace_files import Message, ping_session, write_pair
from trace_files import run as run_of

PING = ["--role", "ping", "--out", "x.mcap", "--backend", "socket", "--discovery", "localhost"]
RELAY = ["--role", "relay", "--out", "x.mcap", "--backend", "socket", "--discovery", "localhost"]
LARGE = "1" + "0" * 400
"""10^400."""

FINDS: dict[str, list[tuple[list[str], int]]] = {
    "dds-record": [
        ([*PING, "--size", "3GB"], 2),
        ([*PING, "--size", "999999999999GB"], 2),
        ([*PING, "--messages", "1000000000000"], 2),
        ([*PING, "--messages", LARGE], 2),
        ([*PING, "--messages", "1e12"], 2),
        ([*PING, "--warmup", LARGE], 2),
        ([*PING, "--duration", "nan"], 2),
        ([*RELAY, "--duration", "inf"], 2),
        ([*PING, "--duration", "31622400", "--rate", "1000"], 2),
        ([*PING, "--rate", "1e-300"], 2),
        ([*PING, "--wait", "-1"], 2),
        ([*PING, "--wait", "nan"], 2),
        ([*PING, "--wait", "inf"], 2),
        ([*PING, "--data", "file:"], 2),
        ([*PING, "--data", "topic:"], 2),
        ([*PING, "--data", "topic:a b"], 2),
        ([*PING, "--data", "topic:\u00e9"], 2),
        ([*PING, "--data", "topic:\udcff"], 2),
        ([*PING, "--data", "topic:" + "x" * 400], 2),
        ([*PING, "--label", "a=\udcff"], 2),
        ([*PING, "--label", "\udcff=a"], 2),
        ([*PING, "--setting", "a=\udcff"], 2),
        ([*PING, "--device", "\udcff"], 2),
        ([*RELAY, "--connectivity", "\udcff"], 2),
        ([*RELAY, "--rmw", "\udcff"], 2),
        ([*RELAY, "--depth", "1000000000000"], 2),
        ([*PING, "--peer", "\udcff"], 2),
        ([*PING, "--relay-domain", "9999"], 2),
        ([*PING, "--cpu-affinity", "0-99999999999"], 2),
        ([*RELAY, "--realtime", LARGE], 2),
        ([*PING[:3], "", "--backend", "socket"], 2),
        ([*PING[:3], "x" * 300 + ".mcap"], 2),
    ],
    "dds-analyze": [
        (["runs", "--out", "\udcff"], 2),
        (["x" * 5000], 2),
        (["runs", "--cluster", "zzz"], 2),
        (["runs", "--deadline", "nan"], 2),
        (["gopher://x"], 3),
        (["surrogates", "--report", "md", "--report", "html", "--report", "json"], 0),
        (["surrogates", "--report", "terminal", "--export", "csv", "--out", "o"], 0),
        (["large"], 4),
        (["far"], 4),
        (["many"], 4),
    ],
    "dds-trace choose": [(["runs", "--size", "33KB", "--rate", "nan", "--deadline", "50ms"], 2)],
    "dds-trace compare": [
        (["runs", "runs", "--out", ""], 2),
        (["x" * 5000, "runs"], 2),
        (["runs", "runs", "--fail-if", "latency_p99 > +nan%"], 2),
        (["surrogates", "surrogates", "--report", "md"], 0),
    ],
    "dds-trace watch": [
        (["runs", "--port", "0", "--every", "inf"], 2),
        (["runs", "--port", "0", "--host", "\udcff"], 2),
        (["runs", "--port", "0", "--host", ""], 2),
        (["runs", "--port", "0", "--out", "\udcff"], 2),
    ],
    "dds-trace studio": [(["--port", LARGE], 2)],
    "dds-trace bag": [(["x" * 5000], 2)],
    "dds-trace recover": [([LARGE], 2)],
    "dds-trace doctor": [(["--out", "\udcff"], 2)],
    "dds-trace bridge": [
        (["builtin-zenoh", "--listen", "a:\u00b2"], 2),
        (["zenoh-bridge-dds", "--config", "--peer", '"\n:1'], 2),
        (["builtin", "--depth", LARGE], 2),
        (["builtin", "--from", LARGE], 2),
        (["\udcff"], 2),
    ],
    "dds-trace sweep new": [(["n.toml", "--send", "imu @ \u0661"], 2), (["p.toml", "--send", "imu @ 1"], 5)],
    "dds-trace capacity": [(["nan.toml", "--dry-run"], 2)],
    "dds-trace explain rates": [(["p.toml", "--dry-run"], 2)],
    "dds-trace explain size": [(["2KB..1KB", "p.toml", "--dry-run"], 2)],
    "dds-trace advise": [(["inf.toml", "--dry-run"], 2)],
    "dds-trace sweep": [
        (["latin.toml", "--dry-run"], 2),
        (["/dev/zero", "--dry-run"], 2),
        (["nan.toml", "--dry-run"], 2),
        (["inf.toml"], 2),
        (["settle.toml"], 2),
        (["p.toml", "--max-passes", LARGE, "--until", "latency_p99:5%"], 2),
        (["p.toml", "--until", f"latency_p99:{LARGE}%"], 2),
        (["p.toml", "--against", LARGE], 2),
        (["p.toml", "--out", "\udcff"], 2),
    ],
}
"""Command -> arguments and exit code."""

CASES = [(command, *find) for command, finds in FINDS.items() for find in finds]
NAMES = [f"{command.replace(' ', '-')}-{number}" for command, finds in FINDS.items() for number in range(len(finds))]
PLANS = {
    "p.toml": b"[run]\nmessages = 1\n[axes]\nbackend = 'socket'\n",
    "latin.toml": b"name = '\xe9'\n",
    "nan.toml": b"[axes]\nrate = nan\n",
    "inf.toml": b"[run]\nseconds = inf\n",
    "settle.toml": b"[run]\nsettle_seconds = -1\n",
}


def write_surroundings(folder):
    for name, data in PLANS.items():
        (folder / name).write_bytes(data)
    timeline = [Message(s, t0=s * 10**8, t1=s * 10**8, t3=9, t4=10, t2=s * 10**8 + 90) for s in range(12)]
    sides = {
        "runs": {},
        "surrogates": {"ping": replace(ping_session(), device="\udcff\ud800")},
        "large": {"ping": replace(ping_session(), domain_id=10**400)},
        "far": {"ping": replace(ping_session(), wall_anchor_ns=2**63 - 1)},
        "many": {"runs": [run_of(planned_messages=2**63 - 1)]},
    }
    for name, changed in sides.items():
        write_pair(folder / name, timeline, **changed)


@pytest.fixture(scope="module")
def surroundings(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finds")
    write_surroundings(folder)
    return folder


@pytest.mark.parametrize(("command", "arguments", "code"), CASES, ids=NAMES)
def test_a_find_is_one_line_and_a_documented_exit_code(surroundings, monkeypatch, command, arguments, code, sentences):
    monkeypatch.chdir(surroundings)
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    ended, _, err = run(command, arguments)
    reasons = check_told(command, ended, err)
    assert ended == code, err
    if code:
        sentences(*(line.replace(str(surroundings), "FOLDER")[:500] for line in reasons))


def run_as_process(folder, command, arguments):
    program, *names = command.split()
    done = subprocess.run(
        [Path(sys.executable).with_name(program), *names, *map(os.fsencode, arguments)],
        cwd=folder,
        capture_output=True,
        check=False,
    )
    return done.returncode, done.stderr.decode(errors="backslashreplace")


@pytest.mark.thorough
def test_each_command_as_a_process_says_what_it_says_here(surroundings):
    firsts = [(command, *FINDS[command][-1]) for command in COMMANDS]
    with ThreadPoolExecutor(2) as pool:
        done = list(pool.map(lambda find: run_as_process(surroundings, *find[:2]), firsts))
    for (command, _, code), (ended, err) in zip(firsts, done, strict=True):
        check_told(command, ended, err)
        assert ended == code, err


@pytest.mark.slow
@pytest.mark.parametrize(("command", "arguments", "code"), CASES, ids=NAMES)
def test_a_find_as_a_process(surroundings, command, arguments, code):
    if any("\ud800" <= c <= "\udfff" and not c >= "\udc80" for a in arguments for c in a):
        pytest.skip("no byte of a command line is this surrogate")
    ended, err = run_as_process(surroundings, command, arguments)
    check_told(command, ended, err)
    assert ended == code, err

"""Whole commands on what trials and hypothesis have found: a documented exit code and one line, never a traceback."""

from __future__ import annotations

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

FINDS: dict[str, list[tuple[list[str], int, str]]] = {
    "dds-record": [
        (
            [*PING, "--size", "3GB"],
            2,
            "--size 3000000000: the size of a message in bytes must be between 0 and 1073741824",
        ),
        ([*PING, "--size", "999999999999GB"], 2, "--size a number of about 22 digits: "),
        (
            [*PING, "--messages", "1000000000000"],
            2,
            "--messages 1000000000000: the number of messages to measure must be between 1 and",
        ),
        ([*PING, "--messages", LARGE], 2, "--messages a number of about 401 digits: "),
        ([*PING, "--messages", "1e12"], 2, "'1e12' is not a valid int"),
        ([*PING, "--warmup", LARGE], 2, "--warmup a number of about 401 digits: "),
        ([*PING, "--duration", "nan"], 2, "--duration nan: a length in seconds must be above 0 and at most 31622400"),
        ([*RELAY, "--duration", "inf"], 2, "--duration inf: "),
        (
            [*PING, "--duration", "31622400", "--rate", "1000"],
            2,
            "the number of messages to measure must be between 1 and 100000000",
        ),
        (
            [*PING, "--rate", "1e-300"],
            2,
            "--rate 1e-300: a rate in messages a second must be between 1e-06 and 1000000",
        ),
        ([*PING, "--wait", "-1"], 2, "--wait -1: a wait in seconds must be between 0 and 31622400"),
        ([*PING, "--wait", "nan"], 2, "--wait nan: "),
        ([*PING, "--wait", "inf"], 2, "--wait inf: "),
        ([*PING, "--data", "file:"], 2, "--data file:: write file:PATH, a file or a folder of files"),
        ([*PING, "--data", "topic:"], 2, "--data topic: '': write a ROS topic's name such as /camera/image"),
        ([*PING, "--data", "topic:a b"], 2, "--data topic: 'a b': write a ROS topic's name"),
        ([*PING, "--data", "topic:\u00e9"], 2, "--data topic: '\u00e9': write a ROS topic's name"),
        ([*PING, "--data", "topic:\udcff"], 2, "--data 'topic:\\udcff': a text must be UTF-8 text"),
        (
            [*PING, "--data", "topic:" + "x" * 400],
            2,
            "a ROS topic's name such as /camera/image has at most 200 characters",
        ),
        (
            [*PING, "--label", "a=\udcff"],
            2,
            "--label a '\\udcff': a text must be UTF-8 text; this is in another encoding",
        ),
        ([*PING, "--label", "\udcff=a"], 2, "--label '\\udcff': "),
        ([*PING, "--setting", "a=\udcff"], 2, "--setting a '\\udcff': "),
        ([*PING, "--device", "\udcff"], 2, "--device '\\udcff': a name of one line must be UTF-8 text"),
        ([*RELAY, "--connectivity", "\udcff"], 2, "--connectivity '\\udcff': "),
        ([*RELAY, "--rmw", "\udcff"], 2, "--rmw '\\udcff': "),
        ([*RELAY, "--depth", "1000000000000"], 2, "--depth 1000000000000: the number of messages that keep_last keeps"),
        ([*PING, "--peer", "\udcff"], 2, "--peer '\\udcff': a host's name or address must be UTF-8 text"),
        ([*PING, "--relay-domain", "9999"], 2, "--relay-domain 9999: a DDS domain id must be between 0 and 231"),
        ([*PING, "--cpu-affinity", "0-99999999999"], 2, "--cpu-affinity '0-99999999999': write CPU numbers and ranges"),
        (
            [*RELAY, "--realtime", LARGE],
            2,
            "--realtime a number of about 401 digits: a SCHED_FIFO priority must be between 1 and 99",
        ),
        ([*PING[:3], "", "--backend", "socket"], 2, "--out '.': a path ends with a name"),
        ([*PING[:3], "x" * 300 + ".mcap"], 2, "a path has names of at most 255 bytes; one has 305"),
        (["--self-test", "--rmw", "\udcff"], 2, "--rmw '\\udcff': "),
        (["--self-test", "--domain", "999"], 2, "--domain 999: a DDS domain id must be between 0 and 231"),
        (["--recover", LARGE], 2, "--recover '1000"),
    ],
    "dds-analyze": [
        (["runs", "--out", "\udcff"], 2, "--out '\\udcff': a path must be UTF-8 text"),
        (["x" * 5000], 2, "a path has at most 4095 characters; this has 5000"),
        (["runs", "--cluster", "zzz"], 2, "--cluster 'zzz': write HOST:PORT or tcp://HOST:PORT"),
        (["runs", "--deadline", "nan"], 2, "--deadline 'nan' is not understood"),
        (["runs", "--recommend", "data=binary size=33KB rate=nan deadline=50ms"], 2, "rate=nan is not understood"),
        (["gopher://x"], 3, "gopher://x: cannot be read (Protocol not known: gopher)"),
        (["surrogates", "--report", "md", "--report", "html", "--report", "json"], 0, ""),
        (["surrogates", "--report", "terminal", "--export", "csv", "--out", "o"], 0, ""),
        (["large"], 4, "an integer of 401 digits does not fit into 64 bits"),
        (["far"], 4, "field 'wall_anchor_ns' of the session description is 9223372036854775807; a time in ns must be"),
        (["many"], 4, "field 'planned_messages' of the run description is 9223372036854775807; a count must be"),
    ],
    "dds-analyze compare": [
        (["runs", "runs", "--out", ""], 2, "--out '.': a path ends with a name"),
        (["x" * 5000, "runs"], 2, "BASE 'xxx"),
        (["runs", "runs", "--fail-if", "latency_p99 > +nan%"], 2, "no limit '+nan%'"),
        (["surrogates", "surrogates", "--report", "md"], 0, ""),
    ],
    "dds-analyze watch": [
        (
            ["runs", "--port", "0", "--every", "inf"],
            2,
            "--every inf: the time between two checks in seconds must be between 0.1 and",
        ),
        (
            ["runs", "--port", "0", "--host", "\udcff"],
            2,
            "--host '\\udcff': a host's name or address must be UTF-8 text",
        ),
        (["runs", "--port", "0", "--host", ""], 2, "--host '': write a host's name or address"),
        (["runs", "--port", "0", "--out", "\udcff"], 2, "--out '\\udcff': a path must be UTF-8 text"),
    ],
    "dds-bridge": [
        (["builtin-zenoh", "--listen", "a:\u00b2"], 2, "'a:\u00b2' is not an address; write HOST:PORT"),
        (["zenoh-bridge-dds", "--print-config", "--peer", '"\n:1'], 2, "is not an address; write HOST:PORT"),
        (["builtin", "--depth", LARGE], 2, "--depth a number of about 401 digits: "),
        (
            ["builtin", "--from", LARGE],
            2,
            "there is no domain a number of about 401 digits; a DDS domain id must be between 0 and 231",
        ),
        (["\udcff"], 2, "there is no bridge '\\udcff'"),
    ],
    "dds-sweep new": [
        (["n.toml", "--send", "imu @ \u0661"], 2, "write a kind, a size and a rate"),
        (["p.toml", "--send", "imu @ 1"], 5, "p.toml is there already; choose another name"),
    ],
    "dds-sweep": [
        (["latin.toml", "--dry-run"], 2, "a plan is UTF-8 text"),
        (["/dev/zero", "--dry-run"], 2, "/dev/zero: not a regular file"),
        (["nan.toml", "--dry-run"], 2, "nan.toml: [axes]: rate is nan; a rate in messages a second must be"),
        (["inf.toml"], 2, "inf.toml: [run]: seconds is inf; a length in seconds must be between 0 and 31622400"),
        (
            ["settle.toml"],
            2,
            "settle.toml: [run]: settle_seconds is -1; a wait in seconds must be between 0 and 31622400",
        ),
        (
            ["p.toml", "--max-passes", LARGE, "--until", "latency_p99:5%"],
            2,
            "--max-passes a number of about 401 digits: ",
        ),
        (["p.toml", "--until", f"latency_p99:{LARGE}%"], 2, "write STATISTIC:PERCENT"),
        (["p.toml", "--against", LARGE], 2, "--against '1000"),
        (["p.toml", "--out", "\udcff"], 2, "--out '\\udcff': a path must be UTF-8 text"),
    ],
}
"""Command -> arguments, exit code, and a part of what is said."""

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
    """Write plans, and traces whose descriptions hold what nobody means."""
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


@pytest.mark.parametrize(("command", "arguments", "code", "said"), CASES, ids=NAMES)
def test_a_find_is_one_line_and_a_documented_exit_code(surroundings, monkeypatch, command, arguments, code, said):
    monkeypatch.chdir(surroundings)
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    ended, out, err = run(command, arguments)
    check_told(command, ended, err)
    assert ended == code, err
    assert said.encode(errors="backslashreplace") in (out + err).encode(errors="backslashreplace")


def run_as_process(folder, command, arguments):
    """Run the installed command; its exit code and stderr."""
    program, *names = command.split()
    done = subprocess.run(
        [Path(sys.executable).with_name(program), *names, *map(os.fsencode, arguments)],
        cwd=folder,
        capture_output=True,
        check=False,
        timeout=120,
    )
    return done.returncode, done.stderr.decode(errors="backslashreplace")


def test_each_command_as_a_process_says_what_it_says_here(surroundings):
    firsts = [(command, *FINDS[command][-1]) for command in COMMANDS]
    with ThreadPoolExecutor(2) as pool:
        done = list(pool.map(lambda find: run_as_process(surroundings, *find[:2]), firsts))
    for (command, _, code, _), (ended, err) in zip(firsts, done, strict=True):
        check_told(command, ended, err)
        assert ended == code, err


@pytest.mark.slow
@pytest.mark.parametrize(("command", "arguments", "code", "said"), CASES, ids=NAMES)
def test_a_find_as_a_process(surroundings, command, arguments, code, said):
    if any("\ud800" <= c <= "\udfff" and not c >= "\udc80" for a in arguments for c in a):
        pytest.skip("no byte of a command line is this surrogate")
    ended, err = run_as_process(surroundings, command, arguments)
    check_told(command, ended, err)
    assert ended == code, (err, said)

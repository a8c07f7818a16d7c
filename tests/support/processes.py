"""Real `dds-record` processes in tests: started, waited for by what they say, and always ended by their pid."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from waiting import PATIENCE_S, wait_until
from warm_start import MODULES, WarmProcess

from dds_trace.recorder.domains import domain_port_range


@dataclass(frozen=True)
class Finished:
    status: int
    stdout: str
    stderr: str


def own_port(domain_id: int) -> int:
    """A port of the test's own domain that no participant takes; it is below those that connections get, so it stays free."""
    return domain_port_range(domain_id)[-1]


def counts_in(text: str) -> list[int]:
    return [int(number) for number in re.findall(r"\b\d+\b", text.replace(",", ""))]


class RunningCommand:
    """One of our commands as a process; `finish` or `stop` it.

    Args:
        arguments: of the command, its name first.
        environment: variables that differ from ours.
        prefix: a command that becomes ours, as `nsenter` does.

    With one of these it starts cold, as an installed script; else warm.
    """

    def __init__(
        self, *arguments: object, environment: dict[str, str] | None = None, prefix: Sequence[str] = ()
    ) -> None:
        program, *rest = map(str, arguments)
        self._process: subprocess.Popen[str] | WarmProcess
        if program in MODULES and not prefix and not environment:
            self._process = WarmProcess(program, rest)
        else:
            self._process = subprocess.Popen(
                [*prefix, Path(sys.executable).with_name(program), *rest],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                env={**os.environ, **(environment or {})},
            )
        self._lines: dict[str, list[str]] = {"stdout": [], "stderr": []}
        self._readers = [threading.Thread(target=self._read, args=(name,), daemon=True) for name in self._lines]
        for reader in self._readers:
            reader.start()

    def _read(self, name: str) -> None:
        with getattr(self._process, name) as pipe:
            for line in pipe:
                self._lines[name].append(line)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def printed(self) -> list[str]:
        return list(self._lines["stdout"])

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def wait_for_line(self, text: str) -> str:
        deadline = time.monotonic() + PATIENCE_S
        while True:
            ended = self._process.poll() is not None
            for line in list(self._lines["stderr"]):
                if text in line:
                    return line
            assert not ended, f"ended with {self._process.returncode} before {text!r}: {self._lines}"
            assert time.monotonic() < deadline, f"no {text!r} in {self._lines}"
            time.sleep(0.02)

    def send_signal(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def finish(self) -> Finished:
        status = self._process.wait(PATIENCE_S)
        for reader in self._readers:
            reader.join(PATIENCE_S)
        return Finished(status, "".join(self._lines["stdout"]), "".join(self._lines["stderr"]))

    def stop(self, number: signal.Signals = signal.SIGTERM) -> Finished:
        self.send_signal(number)
        return self.finish()

    def clean_up(self) -> None:
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait(PATIENCE_S)


@contextmanager
def running(
    *arguments: object, environment: dict[str, str] | None = None, prefix: Sequence[str] = ()
) -> Iterator[RunningCommand]:
    command = RunningCommand(*arguments, environment=environment, prefix=prefix)
    try:
        yield command
    finally:
        command.clean_up()


@contextmanager
def relay(domain_id: int, out: Path, *more: object) -> Iterator[RunningCommand]:
    """A relay that serves already; stop it within the block to have its trace closed."""
    with running("dds-record", "--role", "relay", "--domain", domain_id, "--out", out, *more) as command:
        command.wait_for_line("serves domain")
        yield command


def wait_for_chunks(path: Path) -> None:
    wait_until(lambda: path.exists() and path.stat().st_size >= 4000)


def ping(domain_id: int, out: Path, *more: object) -> Finished:
    return run("dds-record", "--role", "ping", "--domain", domain_id, "--out", out, *more)


def record_pair(domain_id: int, folder: Path, both: Sequence[object] = (), more: Sequence[object] = ()) -> Finished:
    """A ping with options of its own (`more`) and its relay, each with its trace in the folder; how the ping ended."""
    with relay(domain_id, folder / "relay.mcap", *both) as command:
        done = ping(domain_id, folder / "ping.mcap", *both, *more)
        command.stop()
    return done


def run(*arguments: object, environment: dict[str, str] | None = None) -> Finished:
    with running(*arguments, environment=environment) as command:
        return command.finish()


def socket_plan(domain_id: int, *, messages: int = 20, repeats: int = 3, size: str = "1KB", more: str = "") -> str:
    """The text of a plan with one result over sockets, whose runs are short."""
    return (
        f"[run]\nmessages = {messages}\nwarmup = 2\nsettle_seconds = 0\nrepeats = {repeats}\norder = 'alternating'\nown_cost_passes = 1\n"
        f"domain = {domain_id}\n[axes]\nbackend = 'socket'\nsize = '{size}'\nrate = 200\n{more}"
    )


def sweep(folder: Path, text: str) -> dict[str, Any]:
    """Return what the sweep of a plan prints; it starts cold with network namespaces, outside of which a warm one would stay."""
    plan = folder / "p.toml"
    plan.write_text(text)
    cold = {"PATH": os.environ["PATH"]} if "namespaces = true" in text else None
    done = run("dds-trace", "sweep", plan, "--out", folder / "runs", "--json", environment=cold)
    assert done.status == 0, done.stderr
    return json.loads(done.stdout)


def executed(words: Sequence[object], variables: Mapping[str, str] | None = None, **options: Any) -> Any:
    """Run a program to its end, with variables beside ours, and return what it printed."""
    if variables is not None:
        options["env"] = {**os.environ, **variables}
    return subprocess.run([*map(str, words)], capture_output=True, text=True, check=False, **options)

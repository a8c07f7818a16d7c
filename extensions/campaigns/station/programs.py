"""A `dds-record` process of a sweep, which ends even when the sweep is killed."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from dds_trace.base.errors import BackendUnavailableError, OptionError, OutputError
from dds_trace.base.files import create_file, expand_home
from dds_trace.extensions.bridges.programs import program_environment
from dds_trace.extensions.bridges.supervise import describe_end
from dds_trace.recorder.host.child import Child
from dds_trace.recorder.recording import SERVING

DEFAULTS_VARIABLE = "DDS_TRACE_CONFIG"
"""Empty for the programs of a sweep: no file of defaults adds to a plan."""

STOP_PATIENCE_S = 60.0
"""Time for a recorder to wait for late replies, close its trace and stop its bridge."""

REHEARSAL_PATIENCE_S = 60.0

REHEARSAL_STOP_S = 10.0
LAST_WORDS_BYTES = 4096
MOST_LOG_BYTES = 64 << 20

_SERVING = re.compile(rf"relay ([0-9a-f]{{8}}) {SERVING}")
_REASON = re.compile(r"dds-\w+: ")


def local_program(name: str) -> list[str]:
    installed = Path(sys.executable).with_name(name)
    return [str(installed if installed.exists() else shutil.which(name) or name)]


def environment_program(folder: Path, name: str) -> tuple[str, ...]:
    """Return the words that run a command of another Python environment, without our ROS 2 variables."""
    program = folder / "bin" / name
    if not program.exists():
        raise OptionError(f"{folder} has no bin/{name}; install dds-trace there, or give another folder")
    variables = program_environment({}, foreign=True)
    changed = [key for key in os.environ if variables.get(key) != os.environ[key]]
    words = [word for key in changed if key not in variables for word in ("-u", key)]
    words += [f"{key}={variables[key]}" for key in changed if key in variables]
    return ("env", *words, str(program))


def missing_environment(environment: str) -> str | None:
    try:
        if environment:
            environment_program(expand_home(environment).absolute(), "dds-record")
    except OptionError as err:
        return str(err)
    return None


class Program:
    """One running program with a log; `stops_by_input` on another device: it ends when its standard input closes."""

    def __init__(
        self, command: Sequence[str], log: Path, *, stops_by_input: bool = False, lock: int | None = None
    ) -> None:
        self.log = log
        if shutil.which(command[0]) is None:
            raise BackendUnavailableError(f"{command[0]} is not installed or not on the PATH")
        prlimit = shutil.which("prlimit") if stops_by_input else None  # util-linux
        limit = [prlimit, f"--fsize={MOST_LOG_BYTES}", "--"] if prlimit else []
        try:
            log.unlink(missing_ok=True)  # a link there is not followed
            output = create_file(log)
        except OSError as err:
            raise OutputError(f"{log}: {err.strerror}; give another --out") from err
        with output:
            self._process = Child(
                [*limit, *command],
                ends_by_input=stops_by_input,
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, DEFAULTS_VARIABLE: ""},
                pass_fds=() if lock is None else (lock,),
            )

    @property
    def exit_code(self) -> int | None:
        return self._process.poll()

    @property
    def failure(self) -> str | None:
        return None if self.exit_code is None else self.last_words()

    @property
    def relay_id(self) -> int | None:
        serving = _SERVING.search(self.log.read_text(errors="replace"))
        return None if serving is None else int(serving[1], 16)

    def wait(self, timeout_s: float) -> int | None:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return self._process.wait(timeout_s)
        return None

    def stop(self, patience_s: float = STOP_PATIENCE_S) -> int:
        """End the program, after most of `patience_s` by force; return its exit code."""
        return self._process.end(patience_s)

    def kill(self) -> int:
        return self._process.kill_all()

    def last_words(self) -> str:
        with self.log.open("rb") as file:
            file.seek(max(0, self.log.stat().st_size - LAST_WORDS_BYTES))
            text = file.read().decode(errors="replace").replace("\r", "\n")
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        starts = [number for number, line in enumerate(lines) if _REASON.match(line)]
        reason = lines[starts[-1] :] if starts else lines[-1:]
        printed = _REASON.sub("", "; ".join(reason)) or "it said nothing"
        return printed if self.exit_code is None else describe_end(self.exit_code, printed)


def rehearse_program(command: Sequence[str], folder: Path) -> str | None:
    trace = folder / "rehearsal.mcap"
    try:
        program = Program([*command, "--out", str(trace), "--check"], folder / "rehearsal.log")
    except BackendUnavailableError as err:
        return str(err)
    try:
        if program.wait(REHEARSAL_PATIENCE_S) is None:
            return f"it did not start within {REHEARSAL_PATIENCE_S:g} s"
    finally:
        code = program.stop(REHEARSAL_STOP_S)
    return program.last_words() if code else None

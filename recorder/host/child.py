"""A child process, which ends with this one however that ends."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Sequence
from typing import Any

_UNLESS_ORPHAN = 'test "$PPID" = "$0" && exec "$@"'


def ending_with_parent() -> list[str]:
    """Return the words before a command by which the kernel ends it with this process; none without `setpriv`."""
    setpriv = shutil.which("setpriv")
    if setpriv is None:
        return []
    return [setpriv, "--pdeathsig", "TERM", "--", "sh", "-c", _UNLESS_ORPHAN, str(os.getpid())]


class Child(subprocess.Popen[bytes]):
    """A program that ends with this process, by SIGTERM or its input's end; Ctrl-C is for this one, as sessions differ."""

    def __init__(
        self,
        command: Sequence[object],
        *,
        ends_by_input: bool = False,
        lost: Callable[[], Exception] = ChildProcessError,
        stdin: int = subprocess.DEVNULL,
        **options: Any,
    ) -> None:
        self._ends_by_input, self.lost = ends_by_input, lost
        super().__init__(
            [*([] if ends_by_input else ending_with_parent()), *map(str, command)],
            stdin=subprocess.PIPE if ends_by_input else stdin,
            start_new_session=True,
            **options,
        )

    def say(self, line: str) -> None:
        assert self.stdin is not None
        try:
            self.stdin.write(f"{line}\n".encode())
            self.stdin.flush()
        except BrokenPipeError as err:
            raise self.lost() from err

    def answer(self) -> Any:
        """Return its next line, which is JSON."""
        assert self.stdout is not None
        line = self.stdout.readline()
        if not line:
            raise self.lost()
        return json.loads(line)

    def end(self, patience_s: float) -> int:
        """End it, after `patience_s` by force; return its exit code."""
        if self.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self.stdin.close()
        for share in (0.8, 0.2):
            if not self._ends_by_input:
                self.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                return self.wait(share * patience_s)
        return self.kill_all()

    def kill_all(self) -> int:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        return self.wait()

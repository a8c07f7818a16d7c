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
    """Return the words before a command that make the kernel end it by SIGTERM with this process.

    Empty without `setpriv` (util-linux). Before `setpriv` runs the parent may have ended, so a shell compares it first.
    """
    setpriv = shutil.which("setpriv")
    if setpriv is None:
        return []
    return [setpriv, "--pdeathsig", "TERM", "--", "sh", "-c", _UNLESS_ORPHAN, str(os.getpid())]


class Child(subprocess.Popen[bytes]):
    """A program in a session of its own, as Ctrl-C is for this process, which ends it in order.

    It ends by SIGTERM, also from the kernel when this process ends, or with `ends_by_input` when its standard input closes.
    `lost` makes the error of `say` and `answer` where it has ended by itself.
    """

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

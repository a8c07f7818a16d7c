"""`WireCapture`: the capturing process, as a role uses it."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from dds_trace.base.errors import OptionError
from dds_trace.tracefile.format.wire import MESSAGE_ROW

from .counts import WireCounts

if TYPE_CHECKING:
    from types import TracebackType

    from typing_extensions import Self

    from dds_trace.tracefile.format.wire import MessageRows

    from .options import WireOptions

_PROCESS = f"{__package__}.process"
_PATIENCE_S = 10.0


@dataclass(frozen=True, slots=True)
class WireResult:
    """Counts and records of one run.

    Attributes:
        counts: of the whole run.
        rows: one of MESSAGE_ROW a message and direction.
    """

    counts: WireCounts
    rows: MessageRows


class WireCapture:
    """A capture from its construction to `close`; packets pass from the construction on.

    Start it before the middleware: the first announcement of a participant is one of the things it looks for.

    Args:
        options: interfaces, ports and memory.

    Raises:
        OptionError: no CAP_NET_RAW, a system without packet sockets, or an interface that cannot be captured.
    """

    def __init__(self, options: WireOptions) -> None:
        if not hasattr(socket, "AF_PACKET"):
            raise OptionError(
                "--wire needs Linux, whose packet sockets (AF_PACKET) this system does not have"
            )
        self._process = subprocess.Popen(
            [sys.executable, "-m", _PROCESS, options.to_json()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for the role, which still wants the counts of its run
        )
        try:
            self._answer()
        except OptionError:
            self.close()
            raise

    @property
    def pid(self) -> int:
        """Id of the capturing process, for whoever samples its CPU share."""
        return self._process.pid

    def begin(self, run_id: int | None = None) -> None:
        """Count anew; returns when all packets before are counted, after a quarter of a second.

        Args:
            run_id: of the run whose messages get rows; None, as a relay does not know it beforehand, for all runs.
        """
        self._ask({"ask": "begin", "run_id": "" if run_id is None else f"{run_id:016x}"})
        self._answer()

    def take(self) -> WireResult:
        """Return what was counted since `begin`, after a quarter of a second in which late packets still count.

        Ask once for each `begin`: rows and the kernel's drops are handed over, not copied. Rows take 61 bytes of memory
        each until then, so a relay that serves for days asks every now and then.
        """
        self._ask({"ask": "take"})
        found = self._answer()
        rows = np.frombuffer(_stream(self._process.stdout).read(found["row_bytes"]), MESSAGE_ROW)
        return WireResult(WireCounts.from_dict(found), rows)

    def close(self) -> None:
        """End the process."""
        if self._process.poll() is None:
            _stream(self._process.stdin).close()
            try:
                self._process.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            _stream(stream).close()

    def _ask(self, question: dict[str, Any]) -> None:
        stream = _stream(self._process.stdin)
        try:
            stream.write(json.dumps(question).encode() + b"\n")
            stream.flush()
        except BrokenPipeError as err:
            raise OptionError(_ENDED) from err

    def _answer(self) -> dict[str, Any]:
        line = _stream(self._process.stdout).readline()
        if not line:
            raise OptionError(_ENDED)
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise OptionError(answer["error"])
        return answer

    def __enter__(self) -> Self:
        """Return the capture itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close."""
        self.close()


_ENDED = "--wire: the capturing process ended by itself; its reason is on stderr"


def _stream(pipe: IO[bytes] | None) -> IO[bytes]:
    assert pipe is not None
    return pipe

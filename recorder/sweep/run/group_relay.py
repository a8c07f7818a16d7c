"""The relay of a group of cells."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.base.errors import BackendUnavailableError, OptionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from ..station.devices import RelayDevice, StartedProgram

HOPELESS_EXIT_CODES = {OptionError.exit_code, BackendUnavailableError.exit_code}
"""Exit codes of `dds-record` that another attempt would repeat."""


class CellFailedError(Exception):
    """Failure of an attempt; `hopeless` if another one would fail the same way."""

    def __init__(self, reason: str, *, hopeless: bool = False) -> None:
        super().__init__(reason)
        self.hopeless = hopeless


class GroupRelay:
    """The relay of a group of cells with its half of a bridge; after it ends by itself a new segment follows."""

    def __init__(
        self, device: RelayDevice, arguments: Sequence[str], half: Sequence[str] | None, new_segments: Iterator[str]
    ) -> None:
        self._device = device
        self._arguments = arguments
        self._half = half
        self._new_segments = new_segments
        self._segments: list[str] = []
        self._running: dict[str, StartedProgram] = {}
        self._hopeless: CellFailedError | None = None

    def serve(self) -> str:
        """Start the relay unless it runs, and return its segment."""
        if self._hopeless is not None:
            raise self._hopeless
        if not self._running:
            segment = next(self._new_segments)
            self._segments.append(segment)
            self._running["relay"] = self._device.start(self._arguments, segment)
            if self._half is not None:
                self._running["bridge's half"] = self._device.start_half(self._half, segment)
        return self.segment

    def check(self) -> None:
        """Raise a `CellFailedError` if a program has ended by itself."""
        ended = next((name for name, program in self._running.items() if program.failure is not None), None)
        if ended is None:
            return
        failure = CellFailedError(
            f"the {ended} ended: {self._running[ended].failure}",
            hopeless=self._running[ended].exit_code in HOPELESS_EXIT_CODES,
        )
        self.stop()
        if failure.hopeless:
            self._hopeless = failure
        raise failure

    @property
    def segment(self) -> str:
        """The latest segment."""
        return self._segments[-1]

    def kill(self) -> None:
        """Kill the relay, so that the next `serve` starts another one."""
        self._running.pop("relay").kill()
        self.end()

    def end(self) -> None:
        """Stop the programs that still run."""
        for program in reversed(self._running.values()):
            program.stop()
        self._running.clear()

    def stop(self) -> list[str]:
        """Stop the programs and return the names of all segments."""
        self.end()
        return self._segments

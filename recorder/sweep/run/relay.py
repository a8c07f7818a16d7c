"""The relay that serves a group of cells, started again in a new segment when it has ended by itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.base.errors import BackendUnavailableError, OptionError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from ..station.devices import RelayDevice, StartedProgram

HOPELESS_EXIT_CODES = {OptionError.exit_code, BackendUnavailableError.exit_code}
"""Exit codes of `dds-record` after which another attempt would end the same way."""


class CellFailedError(Exception):
    """Failure of one attempt at a cell; the text gives the reason.

    Attributes:
        hopeless: whether another attempt would fail alike.
    """

    def __init__(self, reason: str, *, hopeless: bool = False) -> None:
        super().__init__(reason)
        self.hopeless = hopeless


class GroupRelay:
    """The relay of a group of cells, with the half of a bridge beside it where there is one.

    Args:
        device: the device that it runs on.
        arguments: arguments of `dds-record`, without `--out`.
        half: arguments of `dds-bridge`, None without a half beside the relay.
        new_segments: names for the traces of one start after the other.
    """

    def __init__(
        self,
        device: RelayDevice,
        arguments: Sequence[str],
        half: Sequence[str] | None,
        new_segments: Iterator[str],
    ) -> None:
        self._device = device
        self._arguments = arguments
        self._half = half
        self._new_segments = new_segments
        self._segments: list[str] = []
        self._running: dict[str, StartedProgram] = {}
        self._hopeless: CellFailedError | None = None

    def serve(self) -> str:
        """Start the relay unless it runs, and return the name of the segment that it writes.

        Raises:
            CellFailedError: the relay cannot run on its device at all.
        """
        if self._hopeless is not None:
            raise self._hopeless
        if not self._running:
            segment = next(self._new_segments)
            self._segments.append(segment)
            self._running["relay"] = self._device.start(self._arguments, segment)
            if self._half is not None:
                self._running["bridge's half"] = self._device.start_half(self._half, segment)
        return self._segments[-1]

    def check(self) -> None:
        """Raise if the relay or the half beside it has ended by itself; `serve` then starts both again.

        Raises:
            CellFailedError: one of the two has ended.
        """
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

    def stop(self) -> list[str]:
        """Stop the running programs and return the names of all segments written so far."""
        for program in reversed(self._running.values()):
            program.stop()
        self._running.clear()
        return self._segments

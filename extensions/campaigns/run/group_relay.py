"""The relay of a group of cells."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.recorder.options import DEFAULT_WAIT_S
from dds_trace.recorder.roles.ping import MAX_RELAYS

from ..folder import segment_of
from ..station.devices import RelayDevice, StartedProgram

START_POLL_S = 0.05

HOPELESS_EXIT_CODES = {OptionError.exit_code, BackendUnavailableError.exit_code}
"""Exit codes of `dds-record` that another attempt would repeat."""


class CellFailedError(Exception):
    """Failure of an attempt; `hopeless` if another one would fail the same way."""

    def __init__(self, reason: str, *, hopeless: bool = False) -> None:
        super().__init__(reason)
        self.hopeless = hopeless


@dataclass(slots=True)
class GroupRelay:
    """The relays of a group of cells, or one with its half of a bridge; after one ends by itself new segments follow.

    `arguments` are each relay's, by the number of its host; `waits` for them to have started, so that only the ping is new.
    """

    device: RelayDevice
    arguments: Sequence[tuple[int, Sequence[str]]]
    half: Sequence[str] | None
    new_segments: Iterator[str]
    waits: bool = False
    _segments: list[str] = field(default_factory=list, init=False)
    _running: dict[str, StartedProgram] = field(default_factory=dict, init=False)
    _killed_ids: set[int | None] = field(default_factory=set, init=False)
    _hopeless: CellFailedError | None = field(default=None, init=False)

    def serve(self) -> str:
        if self._hopeless is not None:
            raise self._hopeless
        if not self._running:
            segment = next(self.new_segments)
            for number, (host, arguments) in enumerate(self.arguments, 1):
                segment_here = segment_of(segment, number, host)
                self._segments.append(segment_here)
                self._running["relay" if number == 1 else f"relay {number}"] = self.device.start(
                    arguments, segment_here
                )
            if self.half is not None:
                self._running["bridge's half"] = self.device.start_half(self.half, segment)
            until_s = time.monotonic() + DEFAULT_WAIT_S * self.waits
            while time.monotonic() < until_s and None in self._relay_ids():
                self.check()
                time.sleep(START_POLL_S)
        return self.segment

    def check(self) -> None:
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

    def _relay_ids(self) -> set[int | None]:
        return {program.relay_id for name, program in self._running.items() if name.startswith("relay")}

    def check_answers(self, relay_ids: Collection[int]) -> str:
        """Return what to say about relays of others; raise if only those answered."""
        others = {*relay_ids} - self._relay_ids() - self._killed_ids
        if not others or self.device.keeps_traces:
            return ""
        seen = f"another relay answered ({', '.join(f'{relay_id:08x}' for relay_id in sorted(others))})"
        cure = "end what else serves the domain, or give [run] domain another number"
        if len(others) == len(relay_ids):
            self.waits = True
            raise CellFailedError(f"{seen}, not this sweep's; {cure}")
        return f"{seen} as well as this sweep's: its replies are in no result, but it takes part of the machine; {cure}"

    @property
    def segment(self) -> str:
        return self._segments[-len(self.arguments)]

    @property
    def further(self) -> tuple[str, ...]:
        return tuple(self._segments[len(self._segments) - len(self.arguments) + 1 :])

    def kill(self) -> None:
        self._killed_ids |= self._relay_ids()
        self._running.pop("relay").kill()
        self.end()

    def end(self) -> None:
        """Stop the programs that still run: several relays at the same time, half of a bridge before its relay."""
        with ThreadPoolExecutor(1 if self.half is not None else MAX_RELAYS) as pool:
            list(pool.map(lambda program: program.stop(), reversed(self._running.values())))
        self._running.clear()

    def stop(self) -> list[str]:
        self.end()
        return self._segments

"""Runs the cells of a plan one after the other and leaves one closed trace per device and cell.

The relay of a group of cells is started once and writes one trace, a *segment*, under `.parts/`. Each cell's ping
writes its trace there too; when it is whole it moves to its final name, so that a file with a cell's name is
always a complete recording. When the relay is stopped its segment is taken apart into the cells' relay files.
What is in `.parts/` when a sweep begins was left by one that was interrupted: segments are taken apart, pings'
traces thrown away.
"""

from __future__ import annotations

import contextlib
import itertools
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from dds_trace.tracefile import BackendUnavailableError, OptionError, TraceError, TraceFormatError
from dds_trace.tracefile.units.counts import counted

from ..plan.commands import half_arguments, ping_arguments, relay_arguments
from ..plan.estimate import Estimate
from ..station.programs import Program
from .result import CellResult, read_result
from .split import Part, split_relay_trace
from .state import CellState, Status, SweepState

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from ..plan.cells import Cell
    from ..plan.plan import Plan
    from ..plan.schedule import Group
    from ..station.devices import RelayDevice, RunningRelay
    from .progress import SweepProgress

PARTS = ".parts"
START_ALLOWANCE_S = 40.0
"""For a ping to start, with its bridge; the wait for an echo and the schedule come on top."""

POLL_S = 0.2

HOPELESS_EXIT_CODES = {OptionError.exit_code, BackendUnavailableError.exit_code}
"""Of `dds-record`: another attempt would end the same way."""


@dataclass(frozen=True, slots=True)
class Station:
    """Where the two roles of a sweep run.

    Attributes:
        ping_command: `dds-record` on this machine, with what has to stand before it.
        device: of the relay.
        held: the lock of `holding_folder`, for the programs to hold as well.
        wait_s: how long a ping waits for the relay's echo.
        relay_address: of the relay's device as the ping reaches it, None on one machine.
        measure_link: what the emulated link did since the call before; None without one.
    """

    ping_command: Sequence[str]
    device: RelayDevice
    held: int | None = None
    wait_s: float = 20.0
    relay_address: str | None = None
    measure_link: Callable[[], Mapping[str, Any]] | None = None


class Runner:
    """One sweep in its folder.

    Args:
        folder: `runs/NAME`, held with `holding_folder`.
        progress: hears what happens.

    Raises:
        TraceFormatError, OptionError: the folder's state is unreadable or of another plan (`SweepState`).
    """

    def __init__(self, plan: Plan, folder: Path, station: Station, progress: SweepProgress) -> None:
        self.plan = plan
        self.folder = folder
        self._parts = folder / PARTS
        self._parts.mkdir(parents=True, exist_ok=True)
        self._station = station
        self._progress = progress
        self.state = SweepState(folder / "state.json", plan.name, plan.digest)
        self._estimate = Estimate(plan)

    def run(self, groups: list[Group]) -> list[str]:
        """Runs every cell that is not complete, and gives the names of those that still are not.

        Raises:
            OutputError: the folder cannot be written any more.
        """
        cells = [cell for group in groups for cell in group.cells]
        self.resume()
        done = sum(self.state[cell.name].done for cell in cells)
        self._progress.begin(len(cells), done)
        try:
            if done < len(cells):
                self._station.device.prepare()
            for group in groups:
                waiting = [cell for cell in group.cells if not self.state[cell.name].done]
                if waiting:
                    self._run_group(group, waiting, cells)
        finally:
            self._progress.end()
        return [cell.name for cell in cells if self.state[cell.name].status is not Status.COMPLETE]

    def resume(self) -> None:
        """Takes apart the segments that an interrupted sweep left, and throws its unfinished cells away."""
        for segment in self.state.segments:
            self._collect(segment)
        for path in self._parts.iterdir():
            path.unlink()

    def _run_group(self, group: Group, waiting: list[Cell], all_cells: list[Cell]) -> None:
        with self.relay(group) as relay:
            for cell in waiting:
                left = [other for other in all_cells if not self.state[other.name].done]
                self._progress.cell(cell.name, self._estimate.remaining(left))
                self.record(cell, relay)

    @contextlib.contextmanager
    def relay(self, group: Group) -> Iterator[Relay]:
        """A relay for the cells of this group; when the block is left its part of each is in place."""
        relay = Relay(
            self._station.device,
            relay_arguments(self.plan, group.need),
            half_arguments(self.plan, group) if group.bridge else None,
            self._segment_names(group),
        )
        self._progress.relay(group.need.name)
        try:
            yield relay
        finally:
            for segment in relay.stop():
                self._collect(segment)

    def record(self, cell: Cell, relay: Relay) -> CellState:
        """Records one cell, as often as the plan allows; its state afterwards."""
        for _ in range(self.plan.run.attempts):
            attempt = self.state[cell.name].attempts + 1
            self.state.update(cell.name, status=Status.RUNNING, attempts=attempt, reason="")
            try:
                segment = relay.serve()
                result, link = self._ping(cell, relay)
            except CellFailedError as failure:
                self.state.update(cell.name, status=Status.FAILED, reason=str(failure))
                self._progress.ended(cell.name, f"failed: {failure}", complete=False)
                if failure.hopeless:
                    break
                self._refresh(relay)
            else:
                self.state.update(
                    cell.name,
                    status=Status.RECORDED,
                    run_id=result.run_id,
                    segment=segment,
                    result=asdict(result),
                    link=link,
                )
                self._progress.ended(cell.name, str(result), complete=True)
                if result.received < result.published:
                    self._refresh(relay)
                break
            time.sleep(self.plan.run.settle_seconds)
        time.sleep(self.plan.run.settle_seconds)
        return self.state[cell.name]

    def _refresh(self, relay: Relay) -> None:
        """Ends a relay that may hold parts of messages, so that the next cell gets a new one.

        A reader of Fast DDS that waits for the rest of a large message, whose writer is gone, hands on what others
        write up to some messages late from then on (docs/middlewares.md). That would be the next cell's latency.
        """
        if not self.plan.by_hand:
            relay.stop()

    def _ping(self, cell: Cell, relay: Relay) -> tuple[CellResult, dict[str, Any]]:
        """One attempt: the result, and what the emulated link did meanwhile."""
        draft = self._parts / f"{cell.name}.ping.mcap"
        try:
            return self._attempt(cell, relay, draft)
        finally:  # of a whole one nothing is left here
            for left in self._parts.glob(f"{draft.name}*"):
                left.unlink()

    def _attempt(self, cell: Cell, relay: Relay, draft: Path) -> tuple[CellResult, dict[str, Any]]:
        self._measure_link()
        began_s = time.monotonic()
        log = draft.with_name(draft.name + ".log")
        command = [
            *self._station.ping_command,
            *ping_arguments(self.plan, cell, self._station.wait_s, self._station.relay_address),
            "--out",
            str(draft),
        ]
        program = Program(command, log, held=self._station.held)
        limit_s = (
            START_ALLOWANCE_S
            + self._station.wait_s
            + self.plan.run.planned_seconds(cell.rate)
            + self.plan.run.cutoff_seconds
        )
        try:
            while program.wait(POLL_S) is None and time.monotonic() - began_s < limit_s:
                relay.check()
            cut_off = program.exit_code is None
        finally:  # also at Ctrl-C: the cell is begun anew another time
            code = program.stop()
        if code != 0 and not cut_off:
            raise CellFailedError(program.last_words(), hopeless=code in HOPELESS_EXIT_CODES)
        try:
            result = read_result(draft)
        except (TraceError, OSError) as err:
            raise CellFailedError(f"its trace is not whole: {err}") from err
        if not result.published:
            raise CellFailedError(f"it sent nothing: {program.last_words()}")
        link = self._measure_link()
        if link and link["ping"]["sent_bytes"] < result.sent_bytes:
            raise CellFailedError(
                f"its messages did not cross the link: "
                f"{counted(link['ping']['sent_bytes'], 'byte')} of {result.sent_bytes} did",
                hopeless=True,
            )
        draft.replace(self.ping_path(cell.name))
        self._estimate.measured(cell, time.monotonic() - began_s)
        return result, link

    def _measure_link(self) -> dict[str, Any]:
        if self._station.measure_link is None:
            return {}
        return {"monotonic_ns": time.monotonic_ns(), **self._station.measure_link()}

    def _collect(self, segment: str) -> None:
        """Takes the segment's parts into the cells' relay files."""
        cells = self.state.in_segment(segment)
        device = self._station.device
        try:
            counts = self._split(device.collect(segment), cells) if cells and not device.keeps_traces else {}
        except BackendUnavailableError as err:
            self._progress.note(f"{err}; the relay's trace is fetched when the sweep is run again")
            return
        for name, cell in cells.items():
            if device.keeps_traces or counts.get(int(cell.run_id, 16)) or not cell.result["received"]:
                self.state.update(name, status=Status.COMPLETE, segment="")
            else:
                self.ping_path(name).unlink(missing_ok=True)
                self.state.update(
                    name, status=Status.FAILED, segment="", reason="the relay's part of it is lost"
                )
                self._progress.note(f"{name}: the relay's part of it is lost")
        try:
            device.discard(segment)
        except BackendUnavailableError as err:
            self._progress.note(f"{err}; a trace that is no longer needed stays there")

    def _split(self, path: Path | None, cells: Mapping[str, CellState]) -> dict[int, int]:
        parts = [
            Part(int(cell.run_id, 16), self.relay_path(name), (cell.link,) if cell.link else ())
            for name, cell in cells.items()
        ]
        try:
            return split_relay_trace(path, parts) if path is not None else {}
        except (TraceFormatError, OSError) as err:
            self._progress.note(f"the relay's trace cannot be used: {err}")
            return {}

    def ping_path(self, name: str) -> Path:
        """The ping's trace of a cell."""
        return self.folder / f"{name}.ping.mcap"

    def relay_path(self, name: str) -> Path:
        """The relay's trace of a cell."""
        return self.folder / f"{name}.relay.mcap"

    def _segment_names(self, group: Group) -> Iterator[str]:
        """Names that no earlier sweep in this folder has used; each begins with the group's number."""
        began_ms = time.time_ns() // 1_000_000
        return (f"{group.number}-{began_ms}-{start}.mcap" for start in itertools.count(1))


class CellFailedError(Exception):
    """One attempt at a cell failed; the text says why."""

    def __init__(self, reason: str, *, hopeless: bool = False) -> None:
        super().__init__(reason)
        self.hopeless = hopeless


class Relay:
    """The relay of a group of cells, started again in a new segment when it has ended by itself.

    Args:
        half: arguments of the half of a bridge that runs beside it, None where there is none.
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
        self._running: dict[str, RunningRelay] = {}
        self._hopeless: CellFailedError | None = None

    def serve(self) -> str:
        """Sees to it that a relay runs, and gives the segment that it writes.

        Raises:
            CellFailedError: it cannot run here at all.
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
        """Says so when the relay or the half of a bridge beside it has ended by itself; `serve` then starts them again.

        Raises:
            CellFailedError: one has.
        """
        ended = next((name for name, running in self._running.items() if running.failure is not None), None)
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
        """Ends what runs, and gives the segments that were written."""
        for running in reversed(self._running.values()):
            running.stop()
        self._running.clear()
        return self._segments

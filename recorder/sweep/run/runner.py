"""The runner of a sweep: records cell after cell, one closed trace per device and cell.

The relay of a group of cells writes one trace, a *segment*, into `.parts/`. Each ping writes there too; a complete
trace moves to its final name. When the relay stops, or a sweep is resumed, the segment is split into the cells' relay
files.
"""

from __future__ import annotations

import contextlib
import itertools
import time
from collections import Counter
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from dds_trace.base.errors import BackendUnavailableError, OptionError, TraceError, TraceFormatError
from dds_trace.base.files import output_error
from dds_trace.base.units import counted
from dds_trace.tracefile.format.ring import ring_path

from ...errors import RelayLostError
from ..folder import TRACE_ENDINGS, clear_parts, make_parts, remove_files
from ..plan.commands import half_arguments, ping_arguments, relay_arguments
from ..plan.schedule import Estimate
from ..station.programs import Program
from .result import read_result
from .split import CellPart, split_relay_trace
from .state import CellState, Status, SweepState

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from ..plan.cells import Cell
    from ..plan.link import LinkReport
    from ..plan.plan import Plan
    from ..plan.schedule import CellGroup
    from ..station.devices import RelayDevice, StartedProgram
    from ..station.station import Station
    from .progress import SweepProgress
    from .result import CellResult

START_ALLOWANCE_S = 40.0
"""Time for a ping to start, with its bridge."""

POLL_S = 0.2
START_POLL_S = 0.01
"""Polling period until the first message, with which a link's file starts."""

ENDED_CODES = (0, RelayLostError.exit_code)
"""Exit codes of a ping whose trace counts: while the relay runs, silence is the loss that the cell measures."""

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
        return self._segments[-1]

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

    def stop(self) -> list[str]:
        """Stop the programs and return the names of all segments."""
        for program in reversed(self._running.values()):
            program.stop()
        self._running.clear()
        return self._segments


class Runner:
    """One sweep in its locked folder; cells that are `missing` a middleware (with the reason) are not started."""

    def __init__(
        self,
        plan: Plan,
        folder: Path,
        station: Station,
        progress: SweepProgress,
        missing: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.plan = plan
        self._missing = missing
        self.folder = folder
        self._parts = make_parts(folder)
        self._station = station
        self._progress = progress
        self.state = SweepState(folder / "state.json", plan.name, plan.digest)
        self._estimate = Estimate(plan)

    def _leave_out(self) -> None:
        """Mark cells without a middleware as failed, in one line a reason."""
        waiting = {name: reason for name, reason in self._missing.items() if not self.state[name].done}
        for name, reason in waiting.items():
            self.state[name] = replace(self.state[name], status=Status.FAILED, reason=reason)
        for reason, count in Counter(waiting.values()).items():
            self._progress.note(f"{reason}; {counted(count, 'recording is', 'recordings are')} left out")

    def run(self, groups: list[CellGroup]) -> None:
        """Run every incomplete cell."""
        cells = [cell for group in groups for cell in group.cells]
        self.resume()
        self._leave_out()
        done = sum(self.state[cell.name].done for cell in cells)
        self.state.planned = len(cells)
        self._progress.begin(len(cells), done)
        try:
            if done < len(cells):
                self._prepare_device()
            for group in groups:
                self.run_group(group, cells)
        finally:
            self._progress.end()

    def prepare(self) -> None:
        """Resume, and check that relays can start."""
        self.resume()
        self._leave_out()
        self._prepare_device()

    def _prepare_device(self) -> None:
        self._station.device.prepare()
        self._station.device.clear(self.state.segments)

    def reasons(self, cells: Iterable[Cell]) -> dict[str, str]:
        """Return incomplete cells by name, with the reason."""
        return {
            cell.name: self.state[cell.name].reason or "the relay's trace is still on its device"
            for cell in cells
            if self.state[cell.name].status is not Status.COMPLETE
        }

    def resume(self) -> None:
        """Split the segments of an interrupted sweep; delete its unfinished cells."""
        for segment in self.state.segments:
            self._collect(segment)
        if foreign := clear_parts(self._parts):
            self._progress.note(f"{self._parts} contains {', '.join(foreign)}, which no sweep wrote; not deleted")

    def run_group(self, group: CellGroup, all_cells: list[Cell]) -> None:
        """Run the incomplete cells of a group; the time left counts `all_cells`."""
        waiting = [cell for cell in group.cells if not (self.state[cell.name].done or cell.name in self._missing)]
        if not waiting:
            return
        with self.relay(group) as relay:
            for cell in waiting:
                left = [other for other in all_cells if not self.state[other.name].done]
                remaining = self._estimate.remaining(left)
                self.state.left_s = remaining.seconds
                self._progress.cell(cell.name, remaining)
                self.record(cell, relay)

    @contextlib.contextmanager
    def relay(self, group: CellGroup) -> Iterator[GroupRelay]:
        """Yield the relay of a group; split its trace at the end."""
        relay = GroupRelay(
            self._station.within(group.need.environment).device,
            relay_arguments(self.plan, group.need, group.cells[0].repeat),
            half_arguments(self.plan, group) if group.bridge else None,
            self._segment_names(group),
        )
        self._progress.relay(group.need.relay_name)
        try:
            yield relay
        finally:
            for segment in relay.stop():
                self._collect(segment)

    def record(self, cell: Cell, relay: GroupRelay) -> CellState:
        """Record one cell, as often as the plan allows."""
        for _ in range(self.plan.run.attempts):
            before = self.state[cell.name]
            running = replace(before, status=Status.RUNNING, attempts=before.attempts + 1, reason="")
            self.state[cell.name] = running
            try:
                segment = relay.serve()
                result, link = self._ping(cell, relay)
            except CellFailedError as failure:
                self.state[cell.name] = replace(running, status=Status.FAILED, reason=str(failure))
                self._progress.ended(cell.name, f"failed: {failure}", complete=False)
                if failure.hopeless:
                    break
                self._refresh(relay)
            else:
                self.state[cell.name] = replace(
                    running, status=Status.RECORDED, run_id=result.run_id, segment=segment, result=result, link=link
                )
                self._progress.ended(cell.name, str(result), complete=True)
                if result.received < result.published:
                    self._refresh(relay)
                break
            time.sleep(self.plan.run.settle_seconds)
        time.sleep(self.plan.run.settle_seconds)
        return self.state[cell.name]

    def _refresh(self, relay: GroupRelay) -> None:
        """Stop a relay that may have parts of messages, so that the next cell gets a new one.

        A Fast DDS reader with half a message delivers later ones late (docs/reference/middlewares.md).
        """
        if not self.plan.by_hand:
            relay.stop()

    def _ping(self, cell: Cell, relay: GroupRelay) -> tuple[CellResult, LinkReport | None]:
        draft = self._parts / f"{cell.name}.ping.mcap"
        try:
            return self._attempt(cell, relay, draft)
        finally:  # a complete trace has moved to its final name
            remove_files(self._parts, draft.name, (*TRACE_ENDINGS, ".log"))

    def _attempt(self, cell: Cell, relay: GroupRelay, draft: Path) -> tuple[CellResult, LinkReport | None]:
        self._report_link()  # traffic counts for this attempt from here on
        drive_link = self._station.drive_link
        if drive_link is not None:
            drive_link(starts=False)
        began_s = time.monotonic()
        log = draft.with_name(draft.name + ".log")
        command = [
            *self._station.within(cell.environment).ping_command,
            *ping_arguments(self.plan, cell, self._station.wait_s, self._station.relay_address),
            "--out",
            str(draft),
        ]
        program = Program(command, log, lock=self._station.lock)
        limit_s = (
            START_ALLOWANCE_S
            + self._station.wait_s
            + self.plan.run.planned_seconds(cell.rate)
            + self.plan.run.cutoff_seconds
        )
        try:
            while program.wait(POLL_S if drive_link is None else START_POLL_S) is None and (
                time.monotonic() - began_s < limit_s
            ):
                relay.check()
                if drive_link is not None and ring_path(draft).exists():  # the first message follows
                    drive_link(starts=True)
                    drive_link = None
            cut_off = program.exit_code is None
        finally:  # also at Ctrl-C
            code = program.stop()
        if not cut_off:
            relay.check()  # it may have ended since the last check
        if code not in ENDED_CODES and not cut_off:
            raise CellFailedError(program.last_words(), hopeless=code in HOPELESS_EXIT_CODES)
        try:
            result = read_result(draft)
        except (TraceError, OSError) as err:
            raise CellFailedError(f"its trace is incomplete: {err}") from err
        if not result.published:
            raise CellFailedError(f"it sent nothing: {program.last_words()}")
        link = self._report_link()
        # Only what came back must have crossed: a middleware may drop messages before the link.
        has_bypassed = link is not None and link["ping"]["sent_bytes"] < result.returned_bytes
        final = self.ping_path(cell.name)
        kept = final.with_name(f"{final.name}.bypassed") if has_bypassed else final
        try:
            draft.replace(kept)
        except OSError as err:
            raise output_error(kept, err) from err
        if link is not None and has_bypassed:
            raise CellFailedError(
                f"its messages did not cross the link: {counted(link['ping']['sent_bytes'], 'byte')} of the "
                f"{result.returned_bytes} that came back did; the trace is {kept.name}",
                hopeless=True,
            )
        self._estimate.measured(cell, time.monotonic() - began_s)
        return result, link

    def _report_link(self) -> LinkReport | None:
        return None if self._station.report_link is None else self._station.report_link()

    def _collect(self, segment: str) -> None:
        cells = self.state.in_segment(segment)
        device = self._station.device
        try:
            counts = self._split(device.collect(segment), cells) if cells and not device.keeps_traces else {}
        except BackendUnavailableError as err:
            self._progress.note(f"{err}; the relay's trace is fetched when the sweep is run again")
            return
        for name, cell in cells.items():
            is_silent = cell.result is None or not cell.result.received
            if device.keeps_traces or counts.get(int(cell.run_id, 16)) or is_silent:
                self.state[name] = replace(cell, status=Status.COMPLETE, segment="")
            else:
                self.state[name] = replace(cell, status=Status.FAILED, segment="", reason="its relay trace is lost")
                self._progress.note(f"{name}: its relay trace is lost")
        try:
            device.discard(segment)
        except BackendUnavailableError as err:
            self._progress.note(f"{err}; a trace that is no longer needed stays on the device")

    def _split(self, path: Path | None, cells: Mapping[str, CellState]) -> dict[int, int]:
        drive = self.plan.link.drive if self.plan.link else None
        parts = [
            CellPart(int(cell.run_id, 16), self.relay_path(name), cell.link, drive) for name, cell in cells.items()
        ]
        try:
            return split_relay_trace(path, parts) if path is not None else {}
        except (TraceFormatError, OSError) as err:
            self._progress.note(f"the relay's trace cannot be used: {err}")
            return {}

    def ping_path(self, name: str) -> Path:
        """Return the path of a cell's ping trace."""
        return self.folder / f"{name}.ping.mcap"

    def relay_path(self, name: str) -> Path:
        """Return the path of a cell's relay trace."""
        return self.folder / f"{name}.relay.mcap"

    def _segment_names(self, group: CellGroup) -> Iterator[str]:
        began_ms = time.time_ns() // 1_000_000
        return (f"{group.number}-{began_ms}-{start}.mcap" for start in itertools.count(1))

"""The runner of a sweep: records cell after cell and leaves one closed trace per device and cell.

The relay of a group of cells is started once and writes one trace, a *segment*, under `.parts/`. Each cell's ping
writes its trace there too; when it is whole it moves to its final name, so that a file with a cell's name is
always a complete recording. When the relay is stopped its segment is taken apart into the cells' relay files.
Files in `.parts/` at the start of a sweep were left by an interrupted one: segments are taken apart, traces of
pings deleted.
"""

from __future__ import annotations

import contextlib
import itertools
import time
from dataclasses import replace
from typing import TYPE_CHECKING

from dds_trace.base.errors import BackendUnavailableError, TraceError, TraceFormatError
from dds_trace.base.files import output_error
from dds_trace.base.units import counted

from ...errors import RelayLostError
from ..plan.commands import half_arguments, ping_arguments, relay_arguments
from ..plan.schedule import Estimate
from ..station.devices import TRACE_ENDINGS, clear_parts, make_parts, remove_files
from ..station.programs import Program
from .relay import HOPELESS_EXIT_CODES, CellFailedError, GroupRelay
from .result import read_result
from .split import CellPart, split_relay_trace
from .state import CellState, Status, SweepState

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from ..plan.cells import Cell
    from ..plan.link import LinkReport
    from ..plan.plan import Plan
    from ..plan.schedule import CellGroup
    from ..station.station import Station
    from .progress import SweepProgress
    from .result import CellResult

START_ALLOWANCE_S = 40.0
"""Time for a ping to start, with its bridge; the wait for an echo and the schedule come on top."""

POLL_S = 0.2

ENDED_CODES = (0, RelayLostError.exit_code)
"""Exit codes of a ping whose trace counts: where the relay still runs, its silence is the loss that the cell measures."""


class Runner:
    """One sweep in its folder.

    Args:
        plan: the plan to record.
        folder: `runs/NAME`, held with `holding_folder`.
        station: the devices of ping and relay.
        progress: receiver of every step.

    Raises:
        TraceFormatError, OptionError: the folder's state is unreadable or of another plan (`SweepState`).
    """

    def __init__(self, plan: Plan, folder: Path, station: Station, progress: SweepProgress) -> None:
        self.plan = plan
        self.folder = folder
        self._parts = make_parts(folder)
        self._station = station
        self._progress = progress
        self.state = SweepState(folder / "state.json", plan.name, plan.digest)
        self._estimate = Estimate(plan)

    def run(self, groups: list[CellGroup]) -> list[str]:
        """Run every cell that is not complete and return the names of those that still are not.

        Raises:
            OutputError: the folder cannot be written any more.
        """
        cells = [cell for group in groups for cell in group.cells]
        self.resume()
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
        return list(self.reasons(cells))

    def prepare(self) -> None:
        """Take up what an interrupted sweep left, and check that relays can be started."""
        self.resume()
        self._prepare_device()

    def _prepare_device(self) -> None:
        """Check that relays can be started, and remove what an interrupted sweep left on the device."""
        self._station.device.prepare()
        self._station.device.clear(self.state.segments)

    def reasons(self, cells: Iterable[Cell]) -> dict[str, str]:
        """Return for each of these cells without a complete recording its name and the reason."""
        return {
            cell.name: self.state[cell.name].reason or "the relay's trace is still on its device"
            for cell in cells
            if self.state[cell.name].status is not Status.COMPLETE
        }

    def resume(self) -> None:
        """Take apart the segments that an interrupted sweep left, and delete its unfinished cells."""
        for segment in self.state.segments:
            self._collect(segment)
        if foreign := clear_parts(self._parts):
            self._progress.note(f"{self._parts} holds {', '.join(foreign)}, which no sweep wrote; left alone")

    def run_group(self, group: CellGroup, all_cells: list[Cell]) -> None:
        """Run the cells of a group that are not complete.

        Args:
            group: cells of one relay.
            all_cells: cells of the sweep, for the time that is left.
        """
        waiting = [cell for cell in group.cells if not self.state[cell.name].done]
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
        """Yield a relay for the cells of this group; at the end of the block its part of each is in place."""
        relay = GroupRelay(
            self._station.within(group.need.environment).device,
            relay_arguments(self.plan, group.need, group.cells[0].repeat),
            half_arguments(self.plan, group) if group.bridge else None,
            self._segment_names(group),
        )
        self._progress.relay(group.need.name)
        try:
            yield relay
        finally:
            for segment in relay.stop():
                self._collect(segment)

    def record(self, cell: Cell, relay: GroupRelay) -> CellState:
        """Record one cell, trying as often as the plan allows, and return its new state."""
        for _ in range(self.plan.run.attempts):
            before = self.state[cell.name]
            begun = replace(before, status=Status.RUNNING, attempts=before.attempts + 1, reason="")
            self.state[cell.name] = begun
            try:
                segment = relay.serve()
                result, link = self._ping(cell, relay)
            except CellFailedError as failure:
                self.state[cell.name] = replace(begun, status=Status.FAILED, reason=str(failure))
                self._progress.ended(cell.name, f"failed: {failure}", complete=False)
                if failure.hopeless:
                    break
                self._refresh(relay)
            else:
                self.state[cell.name] = replace(
                    begun,
                    status=Status.RECORDED,
                    run_id=result.run_id,
                    segment=segment,
                    result=result,
                    link=link,
                )
                self._progress.ended(cell.name, str(result), complete=True)
                if result.received < result.published:
                    self._refresh(relay)
                break
            time.sleep(self.plan.run.settle_seconds)
        time.sleep(self.plan.run.settle_seconds)
        return self.state[cell.name]

    def _refresh(self, relay: GroupRelay) -> None:
        """Stop a relay that may hold parts of messages, so that the next cell gets a new one.

        A reader of Fast DDS that waits for the rest of a large message, whose writer is gone, hands on what others
        write up to some messages late from then on (docs/reference/middlewares.md). That would be the next cell's latency.
        """
        if not self.plan.by_hand:
            relay.stop()

    def _ping(self, cell: Cell, relay: GroupRelay) -> tuple[CellResult, LinkReport | None]:
        """Run one attempt; return its result and the report of the emulated link, None without such a link."""
        draft = self._parts / f"{cell.name}.ping.mcap"
        try:
            return self._attempt(cell, relay, draft)
        finally:  # a whole trace has moved to its final name
            remove_files(self._parts, draft.name, (*TRACE_ENDINGS, ".log"))

    def _attempt(self, cell: Cell, relay: GroupRelay, draft: Path) -> tuple[CellResult, LinkReport | None]:
        self._report_link()  # from here on, traffic counts for this attempt
        began_s = time.monotonic()
        log = draft.with_name(draft.name + ".log")
        command = [
            *self._station.within(cell.environment).ping_command,
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
        if not cut_off:
            relay.check()  # it may have ended behind the last look
        if code not in ENDED_CODES and not cut_off:
            raise CellFailedError(program.last_words(), hopeless=code in HOPELESS_EXIT_CODES)
        try:
            result = read_result(draft)
        except (TraceError, OSError) as err:
            raise CellFailedError(f"its trace is not whole: {err}") from err
        if not result.published:
            raise CellFailedError(f"it sent nothing: {program.last_words()}")
        link = self._report_link()
        if link and link["ping"]["sent_bytes"] < result.sent_bytes:
            raise CellFailedError(
                f"its messages did not cross the link: "
                f"{counted(link['ping']['sent_bytes'], 'byte')} of {result.sent_bytes} did",
                hopeless=True,
            )
        try:
            draft.replace(self.ping_path(cell.name))
        except OSError as err:
            raise output_error(self.ping_path(cell.name), err) from err
        self._estimate.measured(cell, time.monotonic() - began_s)
        return result, link

    def _report_link(self) -> LinkReport | None:
        return None if self._station.report_link is None else self._station.report_link()

    def _collect(self, segment: str) -> None:
        """Take a segment apart into the relay files of its cells."""
        cells = self.state.in_segment(segment)
        device = self._station.device
        try:
            counts = self._split(device.collect(segment), cells) if cells and not device.keeps_traces else {}
        except BackendUnavailableError as err:
            self._progress.note(f"{err}; the relay's trace is fetched when the sweep is run again")
            return
        for name, cell in cells.items():
            nothing_came = cell.result is None or not cell.result.received
            if device.keeps_traces or counts.get(int(cell.run_id, 16)) or nothing_came:
                self.state[name] = replace(cell, status=Status.COMPLETE, segment="")
            else:
                remove_files(self.folder, self.ping_path(name).name, ("",))
                self.state[name] = replace(
                    cell, status=Status.FAILED, segment="", reason="the relay's part of it is lost"
                )
                self._progress.note(f"{name}: the relay's part of it is lost")
        try:
            device.discard(segment)
        except BackendUnavailableError as err:
            self._progress.note(f"{err}; a trace that is no longer needed stays there")

    def _split(self, path: Path | None, cells: Mapping[str, CellState]) -> dict[int, int]:
        parts = [
            CellPart(int(cell.run_id, 16), self.relay_path(name), cell.link) for name, cell in cells.items()
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
        """Return names that no earlier sweep in this folder has used; each begins with the group's number."""
        began_ms = time.time_ns() // 1_000_000
        return (f"{group.number}-{began_ms}-{start}.mcap" for start in itertools.count(1))

"""The runner of a sweep: records cell after cell, one closed trace per device and cell.

The relay of a group of cells writes one trace, a *segment*, into `.parts/`, where pings write too. When it stops, or a sweep is
resumed, the segment is split into the cells' relay files.
"""

from __future__ import annotations

import contextlib
import itertools
import signal
import time
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

from dds_trace.base.errors import BackendUnavailableError, TraceError, TraceFormatError
from dds_trace.base.files import output_error
from dds_trace.base.units import counted
from dds_trace.recorder.backends import load_backend
from dds_trace.recorder.errors import RelayLostError
from dds_trace.tracefile.format.ring import ring_path

from ..folder import TRACE_ENDINGS, clear_parts, make_parts, place_of, remove_files
from ..plan.cells import Cell
from ..plan.commands import half_arguments, ping_arguments, relay_arguments
from ..plan.flows import is_crowded, recorded_together, relay_places
from ..plan.link import LinkReport
from ..plan.plan import Plan
from ..plan.schedule import CellGroup, Estimate, start_lead_s
from ..station.devices import RelayDevice
from ..station.programs import Program, missing_environment
from ..station.station import Station
from .group_relay import HOPELESS_EXIT_CODES, CellFailedError, GroupRelay
from .outage import Outage, OutageReport
from .progress import SweepProgress
from .result import CellResult, read_result
from .split import CellPart, split_relay_trace
from .state import CellState, Status, SweepState

START_ALLOWANCE_S = 40.0

POLL_S = 0.2
START_POLL_S = 0.01
"""Polling period until the first message, with which a link's file starts."""

ENDED_CODES = (0, RelayLostError.exit_code)
"""Exit codes of a ping with a trace that counts: while the relay runs, silence is the loss that the cell measures."""


def _check_programs(programs: Iterable[Program]) -> None:
    for program in programs:
        code = program.exit_code
        if code is not None and code not in ENDED_CODES:
            raise CellFailedError(program.last_words(), hopeless=code in HOPELESS_EXIT_CODES)


class Runner:
    """One sweep in its locked folder; cells without their middleware are not started.

    `is_installed_here` is False where other software than this `dds-record` runs: its middlewares are unknown.
    """

    def __init__(
        self, plan: Plan, folder: Path, station: Station, progress: SweepProgress, *, is_installed_here: bool = False
    ) -> None:
        self.plan = plan
        self._is_installed_here = is_installed_here
        self._missing: Mapping[Middlewares, str] = {}
        self.folder = folder
        self._parts = make_parts(folder)
        self.station = station
        self._progress = progress
        self.state = SweepState(folder / "state.json", plan.name, plan.digest)
        self._estimate = Estimate(plan)
        self._noted: set[str] = set()

    def _leave_out(self, cells: Iterable[Cell]) -> None:
        if self._is_installed_here:
            self._missing = missing_middlewares(self.plan, self.station.device)
        waiting = {
            cell.name: reason
            for cell in cells
            if not self._is_done(cell) and (reason := self._missing.get(middlewares_of(cell)))
        }
        for name, reason in waiting.items():
            self._fail(name, reason)
        for reason, count in Counter(waiting.values()).items():
            self._progress.note(f"{reason}; {counted(count, 'recording is', 'recordings are')} left out")

    def run(self, groups: list[CellGroup]) -> None:
        cells = [cell for group in groups for cell in group.cells]
        complete = self.prepare(cells)
        self.state.planned = len(cells)
        self._progress.begin(len(cells), complete)
        try:
            for group in groups:
                self.run_group(group, cells)
        finally:
            self._progress.end()

    def prepare(self, cells: Collection[Cell]) -> int:
        self.resume()
        complete = sum(map(self._is_done, cells))
        if complete < len(cells):
            self.station.device.prepare()
            self.station.device.clear(self.state.segments)
            self._leave_out(cells)
        return complete

    def _is_done(self, cell: Cell) -> bool:
        return self.state[cell.name].done

    def _fail(self, name: str, reason: str) -> CellState:
        self.state[name] = replace(self.state[name], status=Status.FAILED, reason=reason)
        return self.state[name]

    def reasons(self, cells: Iterable[Cell]) -> dict[str, str]:
        return {
            cell.name: self.state[cell.name].reason or "the relay's trace is still on its device"
            for cell in cells
            if self.state[cell.name].status is not Status.COMPLETE
        }

    def resume(self) -> None:
        for segment in self.state.segments:
            self._collect(segment)
        if foreign := clear_parts(self._parts):
            self._progress.note(f"{self._parts} contains {', '.join(foreign)}, which no sweep wrote; not deleted")

    def run_group(self, group: CellGroup, all_cells: list[Cell]) -> None:
        waiting = [
            cells
            for cells in recorded_together(group.cells)
            if any(not (self._is_done(cell) or middlewares_of(cell) in self._missing) for cell in cells)
        ]
        if not waiting:
            return
        with self.relay(group) as relay:
            for cells in waiting:
                unrecorded = [other for other in all_cells if not self.state[other.name].done]
                remaining = self._estimate.remaining(unrecorded)
                self.state.left_s = remaining.seconds
                for cell in cells:
                    self._progress.cell(cell.name, remaining)
                self.record_together(cells, relay)

    @contextlib.contextmanager
    def relay(self, group: CellGroup) -> Iterator[GroupRelay]:
        began_ms = time.time_ns() // 1_000_000
        relay = GroupRelay(
            self.station.within(group.need.environment).device,
            [
                (position.host, relay_arguments(self.plan, group.need, group.cells[0].repeat, position))
                for position in relay_places(group.need)
            ],
            half_arguments(self.plan, group) if group.bridge else None,
            (f"{group.number}-{began_ms}-{start}.mcap" for start in itertools.count(1)),
            waits=any(map(is_crowded, self.plan.cells)),
        )
        self._progress.relay(group.need.relay_name)
        try:
            yield relay
        finally:
            for segment in relay.stop():
                self._collect(segment)

    def record(self, cell: Cell, relay: GroupRelay) -> CellState:
        if reason := self._missing.get(middlewares_of(cell)):
            return self._fail(cell.name, reason)
        self.record_together([cell], relay)
        return self.state[cell.name]

    def record_together(self, cells: Sequence[Cell], relay: GroupRelay) -> None:
        for _ in range(self.plan.run.attempts):
            running = {}
            for cell in cells:
                before = self.state[cell.name]
                running[cell.name] = replace(before, status=Status.RUNNING, attempts=before.attempts + 1, reason="")
                self.state[cell.name] = running[cell.name]
            try:
                segment = relay.serve()
                results, link, outage = self._ping(cells, relay)
            except CellFailedError as failure:
                for name, state in running.items():
                    self.state[name] = replace(state, status=Status.FAILED, reason=str(failure))
                    self._progress.ended(name, f"failed: {failure}", complete=False)
                if failure.hopeless:
                    break
                self._refresh(relay)
            else:
                for (name, state), result in zip(running.items(), results, strict=True):
                    self.state[name] = replace(
                        state,
                        status=Status.RECORDED,
                        run_id=result.run_id,
                        segment=relay.segment,
                        further=relay.further,
                        killed_segment=segment if relay.segment != segment else "",
                        result=result,
                        link=link,
                        outage=outage,
                    )
                    self._progress.ended(name, str(result), complete=True)
                if any(result.received < result.published for result in results):
                    self._refresh(relay)
                break
            time.sleep(self.plan.run.settle_seconds)
        time.sleep(self.plan.run.settle_seconds)

    def _refresh(self, relay: GroupRelay) -> None:
        """Stop a relay that may have parts of messages, so that the next cell gets a new one.

        A Fast DDS reader with half a message delivers later ones late (docs/reference/middlewares.md).
        """
        if not self.plan.by_hand:
            relay.stop()

    def _ping(
        self, cells: Sequence[Cell], relay: GroupRelay
    ) -> tuple[list[CellResult], LinkReport | None, OutageReport | None]:
        drafts = {cell: self._parts / f"{cell.name}.ping.mcap" for cell in cells}
        outage = None
        if cells[0].outage:
            outage = Outage(cells[0], self.plan.run, pair=self.station.pair, kill=relay.kill, serve=relay.serve)
        try:
            with contextlib.nullcontext() if outage is None else outage.repaired():
                results, link = self._attempt(drafts, relay, outage)
            report = None if outage is None else outage.report()
            if outage is not None and report is None:
                raise CellFailedError("the run ended before its outage did")
            return results, link, report
        finally:  # a complete trace has moved to its final name
            for draft in drafts.values():
                remove_files(self._parts, draft.name, (*TRACE_ENDINGS, ".log"))

    def _shape_link(self, cell: Cell) -> None:
        if self.station.pair is not None and (shaped := self.plan.link_of(cell)) is not None:
            self.station.pair.shape(replace(shaped, queue_ms=cell.queue or shaped.queue_ms))
        self._report_link()  # traffic counts for this attempt from here on

    def _attempt(
        self, drafts: Mapping[Cell, Path], relay: GroupRelay, outage: Outage | None
    ) -> tuple[list[CellResult], LinkReport | None]:
        self._shape_link(next(iter(drafts)))
        pair, link = self.station.pair, self.plan.link
        drive_link = pair.drive if pair is not None and link is not None and link.file else None
        if drive_link is not None:
            drive_link(starts=False)
        began_s = time.monotonic()
        lead_s = start_lead_s(len(drafts))
        start = ["--start-at", f"{time.time() + lead_s:.3f}"] if lead_s else []
        run, station = self.plan.run, self.station
        longest_s = lead_s + max(run.planned_seconds(cell.rate, cell.outage) for cell in drafts) + run.cutoff_seconds
        limit_s, has_begun = START_ALLOWANCE_S + station.wait_s + longest_s, False
        programs: dict[Cell, Program] = {}
        ended: dict[Cell, int] = {}
        try:
            for cell, draft in drafts.items():
                arguments = ping_arguments(self.plan, cell, station.wait_s, station.relay_address, station.further)
                command = [*station.within(cell.environment).ping_command, *arguments, *start, "--out", str(draft)]
                programs[cell] = Program(command, draft.with_name(draft.name + ".log"), lock=station.lock)
            poll_s = POLL_S if drive_link is None else START_POLL_S
            # All are waited for in turn.
            while (
                None in [program.wait(poll_s) for program in programs.values()] and time.monotonic() - began_s < limit_s
            ):
                relay.check()
                _check_programs(programs.values())
                if not ring_path(next(iter(drafts.values()))).exists():  # the first message follows
                    continue
                if not has_begun:
                    limit_s, has_begun = min(limit_s, time.monotonic() - began_s + longest_s), True
                if drive_link is not None:
                    drive_link(starts=True)
                    drive_link, poll_s = None, POLL_S
                if outage is not None:
                    outage.step(time.monotonic())
            cut_off = {cell for cell, program in programs.items() if program.exit_code is None}
        finally:  # also at Ctrl-C
            for cell, program in programs.items():
                ended[cell] = program.stop()
        if not cut_off:
            relay.check()  # it may have ended since the last check
        results = [
            self._read(draft, programs[cell], ended[cell], cut_off=cell in cut_off) for cell, draft in drafts.items()
        ]
        self._say_once(relay.check_answers({relay_id for result in results for relay_id in result.relay_ids}))
        report = self._store(drafts, results)
        self._estimate.measured(next(iter(drafts)), time.monotonic() - began_s)
        return results, report

    def _say_once(self, text: str) -> None:
        if text and text not in self._noted:
            self._progress.note(text)
        self._noted.add(text)

    def _store(self, drafts: Mapping[Cell, Path], results: Sequence[CellResult]) -> LinkReport | None:
        """Move complete traces to their final names; refuse traces that did not cross the link."""
        link = self._report_link()
        # Only what came back must have crossed: a middleware may drop messages before the link.
        returned_bytes = sum(result.returned_bytes for result in results)
        has_bypassed = link is not None and link["ping"]["sent_bytes"] < returned_bytes
        for cell, draft in drafts.items():
            final = self.folder / f"{cell.name}.ping.mcap"
            target = final.with_name(f"{final.name}.bypassed") if has_bypassed else final
            try:
                draft.replace(target)
            except OSError as err:
                raise output_error(target, err) from err
        if link is not None and has_bypassed:
            raise CellFailedError(
                f"its messages did not cross the link: {counted(link['ping']['sent_bytes'], 'byte')} of the "
                f"{returned_bytes:,} that came back did; the trace is {target.name}",
                hopeless=True,
            )
        return link

    def _read(self, draft: Path, program: Program, code: int, *, cut_off: bool) -> CellResult:
        if cut_off and code == -signal.SIGKILL:
            raise CellFailedError(
                "it took longer than its plan allows, did not end when asked, and was killed: " + program.last_words()
            )
        if code not in ENDED_CODES and not cut_off:
            raise CellFailedError(program.last_words(), hopeless=code in HOPELESS_EXIT_CODES)
        try:
            result = read_result(draft)
        except (TraceError, OSError) as err:
            raise CellFailedError(f"its trace is incomplete: {err}") from err
        if not result.published:
            raise CellFailedError(f"it sent nothing: {program.last_words()}")
        return result

    def _report_link(self) -> LinkReport | None:
        return None if self.station.pair is None else self.station.pair.report()

    def _collect(self, segment: str) -> None:
        cells, killed = self.state.in_segment(segment), self.state.killed_in(segment)
        device = self.station.device
        is_here = (cells or killed) and not device.keeps_traces
        try:
            counts = self._split(device.collect(segment), cells, killed, place_of(segment)[0]) if is_here else {}
        except BackendUnavailableError as err:
            self._progress.note(f"{err}; the relay's trace is fetched when the sweep is run again")
            return
        for name, cell in killed.items():
            self.state[name] = replace(cell, killed_segment="")
        for name, cell in cells.items():
            is_silent = cell.result is None or not cell.result.received
            # After an outage a new relay may never get a message; the killed one has the others.
            is_expected = device.keeps_traces or is_silent or cell.outage is not None
            count = counts.get(int(cell.run_id, 16))
            # One of several relays may get none of the messages.
            if is_expected or count or (segment in cell.further and count is not None):
                self.state[name] = cell.collected(segment)
            else:
                lost = replace(cell.collected(segment), status=Status.FAILED, reason="its relay trace is lost")
                self.state[name] = lost
                self._progress.note(f"{name}: its relay trace is lost")
        try:
            device.discard(segment)
        except BackendUnavailableError as err:
            self._progress.note(f"{err}; a trace that is no longer needed stays on the device")

    def _split(
        self, path: Path | None, cells: Mapping[str, CellState], killed: Mapping[str, CellState], number: int
    ) -> dict[int, int]:
        drive = self.plan.link.drive if self.plan.link else None
        parts = [
            CellPart(int(cell.run_id, 16), self.relay_path(name, number), cell.link, drive, cell.outage)
            for name, cell in cells.items()
        ]
        parts += [
            CellPart(int(cell.run_id, 16), self.folder / f"{name}.relay-killed.mcap", outage=cell.outage)
            for name, cell in killed.items()
        ]
        try:
            return split_relay_trace(path, parts) if path is not None else {}
        except (TraceFormatError, OSError) as err:
            self._progress.note(f"the relay's trace cannot be used: {err}")
            return {}

    def relay_path(self, name: str, number: int = 1) -> Path:
        return self.folder / f"{name}.relay{'' if number == 1 else f'-{number}'}.mcap"


Middlewares: TypeAlias = "tuple[str, str, str | None, str, str | None, str | None]"
"""Environment, backend and RMW of the ping, backend and RMW of the relay, and the middleware's own configuration."""


def middlewares_of(cell: Cell) -> Middlewares:
    return cell.environment, cell.backend, cell.rmw, cell.relay.backend, cell.relay.rmw, cell.configuration


def missing_middlewares(plan: Plan, device: RelayDevice) -> dict[Middlewares, str]:
    reasons: dict[tuple[str, str | None, str | None, bool], str | None] = {}

    def reason_of(backend: str, rmw: str | None, middleware: str | None, *, is_remote: bool) -> str | None:
        key = backend, rmw, middleware, is_remote
        if key not in reasons:
            reasons[key] = None if is_remote else missing_here(backend, rmw)
            # Only the middleware itself knows which keys it knows.
            if is_remote or (
                not reasons[key] and (middleware is not None or load_backend(backend).environment.sources())
            ):
                arguments = relay_arguments(plan, Cell(backend=backend, rmw=rmw, configuration=middleware))
                reasons[key] = device.rehearse(arguments)
        return reasons[key]

    missing = {}
    for needed in dict.fromkeys(map(middlewares_of, plan.cells)):
        environment, backend, rmw, relay_backend, relay_rmw, environment_name = needed
        if environment:
            if reason := missing_environment(environment):
                missing[needed] = reason
            continue
        relay = reason_of(relay_backend, relay_rmw, environment_name, is_remote=plan.has_two_devices)
        if reason := reason_of(backend, rmw, environment_name, is_remote=False) or relay:
            missing[needed] = reason
    return missing


def missing_here(name: str, rmw: str | None) -> str | None:
    backend = load_backend(name)
    if not backend.find_installed():
        return f"{backend.label} is not here: {backend.install}"
    return backend.missing_rmw(rmw) if rmw is not None and backend.missing_rmw is not None else None

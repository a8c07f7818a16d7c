"""Checks after each call of a sweep and at a round's end; every function yields what is wrong."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from chaos_draw import Fault
from shared_memory import PATTERNS, SHM

from dds_trace.base.errors import TraceError
from dds_trace.extensions.campaigns.station.emulation import ip
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.reading.trace import Trace

COMPLETE, INCOMPLETE, FULL, UNAVAILABLE, INTERRUPTED, KILLED = 0, 10, 6, 7, 130, -9
OWN_FILES = {"plan.toml", "state.json", ".lock", ".parts"}
DONE = ("complete", "recorded")

KEPT_MEMORY = ("lttng-ust-wait-*",)
"""Shared memory that libraries leave at a clean end, too: LTTng of rclpy."""


@dataclass(frozen=True, slots=True)
class Call:
    """One call of `dds-trace sweep`: its exit code and output, the faults meanwhile, and the killed command lines."""

    code: int
    output: str
    faults: tuple[Fault, ...]
    struck: tuple[str, ...] = ()

    def had(self, kind: str, target: str = "") -> bool:
        return any(fault.kind == kind and target in ("", fault.target) for fault in self.faults)


def cells_of(folder: Path) -> dict[str, dict[str, object]]:
    path = folder / "state.json"
    cells: dict[str, dict[str, object]] = json.loads(path.read_text())["cells"] if path.exists() else {}
    return cells


def untrue_exit(call: Call, folder: Path, cells: int) -> Iterator[str]:
    states = cells_of(folder)
    complete = sum(cell["status"] == "complete" for cell in states.values())
    missing = [name for name, cell in states.items() if cell["status"] != "complete"]
    if "Traceback (most recent call last)" in call.output:
        yield "it printed a traceback"
    allowed = {
        COMPLETE: complete == cells,
        INCOMPLETE: complete < cells and all(f"{name}: " in call.output for name in missing),
        FULL: call.had("full-disk") and ("the disk is full" in call.output or "--keep-free" in call.output),
        UNAVAILABLE: any("tap_forwarder" in words for words in call.struck),
        INTERRUPTED: call.had("interrupt") and "same command continues" in call.output,
        KILLED: call.had("kill", "sweep"),
    }
    if not allowed.get(call.code):
        yield f"exit code {call.code}, and {complete} of {cells} cells are complete"


def forgotten_cells(before: Mapping[str, object], folder: Path) -> Iterator[str]:
    """Yield the cells whose recording (`before`: name -> run) was complete before a call and is not the same after it."""
    now = cells_of(folder)
    for name, run_id in before.items():
        cell = now.get(name, {})
        if cell.get("status") not in DONE or cell.get("run_id") != run_id:
            yield f"{name} was whole as run {run_id}, and is {cell.get('status')} as {cell.get('run_id')}"


def whole_cells(folder: Path) -> dict[str, object]:
    return {name: cell["run_id"] for name, cell in cells_of(folder).items() if cell["status"] in DONE}


def left_namespaces() -> Iterator[str]:
    yield from (f"network namespace {line}" for line in ip("netns", "list").splitlines())


def left_memory(killed: bool) -> Iterator[str]:
    excused = {path for pattern in (*KEPT_MEMORY, *(PATTERNS if killed else ())) for path in SHM.glob(pattern)}
    yield from (f"shared memory {path}" for path in sorted(SHM.rglob("*")) if path not in excused)


def left_files(*folders: Path) -> Iterator[str]:
    for folder in folders:
        yield from (f"file {path}" for path in sorted(folder.rglob("*")) if not path.is_dir())


def untrue_folder(folder: Path, cells: int) -> Iterator[str]:
    """Yield what is wrong with the folder of a complete sweep: names, traces and their events."""
    names = set(cells_of(folder))
    if len(names) != cells:
        yield f"{len(names)} cells and not {cells}"
    expected = {f"{name}.{role}.mcap" for name in names for role in ("ping", "relay")} | OWN_FILES
    names_there = {path.name for path in folder.iterdir()}
    if names_there != expected:
        yield f"missing {sorted(expected - names_there)}, left over {sorted(names_there - expected)}"
        return
    yield from left_files(folder / ".parts")
    runs = set()
    for name in sorted(names):
        try:
            ping, relay = (read_trace(folder / f"{name}.{role}.mcap") for role in ("ping", "relay"))
        except TraceError as err:
            yield str(err)
            continue
        yield from (f"{name}: {fault}" for fault in untrue_cell(name, ping, relay))
        runs |= {run.run_id for run in ping.runs}
    if len(runs) != cells:
        yield f"{len(runs)} runs in {cells} cells"


def untrue_cell(name: str, ping: Trace, relay: Trace) -> Iterator[str]:
    """Yield what contradicts that a cell is there once, with every event that was stamped for it."""
    if len(ping.runs) != 1 or ping.runs[0].labels.get("cell") != name:
        yield f"runs {[run.labels for run in ping.runs]}"
        return
    (run,) = ping.runs
    for role, trace in (("ping", ping), ("relay", relay)):
        if trace.truncated or trace.notes or trace.unreadable_messages:
            yield f"the {role}'s trace: {trace.truncated}, {trace.notes}"
        if any(session.dropped_events for session in trace.sessions):
            yield f"the {role} dropped events"
    sent, back = (_numbers(ping, stage) for stage in (Stage.T1, Stage.T2))
    came, went = (_numbers(relay, stage) for stage in (Stage.T3, Stage.T4))
    rules = {
        f"published {run.published} and stamped {len(sent)}": len(sent) == run.published,
        "the relay has another run": {run_id for run_id, _ in came | went} <= {run.run_id},
        "the ping has another run": {run_id for run_id, _ in sent | back} <= {run.run_id},
        "a reply without T1": back <= sent,
        "T3 without T1": came <= sent,
        "a reply without T3": back <= came,
        "a reply without T4": back <= went,
        "T4 without T3": went <= came,
    }
    yield from (rule for rule, holds in rules.items() if not holds)
    for stage, trace in ((Stage.T1, ping), (Stage.T2, ping), (Stage.T3, relay), (Stage.T4, relay)):
        if len(trace.events[stage]) != len(_numbers(trace, stage)):
            yield f"{stage.name} is there twice"


def _numbers(trace: Trace, stage: Stage) -> set[tuple[int, int]]:
    columns = trace.events[stage]
    return set(zip(columns.run_id.tolist(), columns.sequence.tolist(), strict=True))

"""The tools of `dds-record` beside recording: `--recover`, `--self-test` and `--check`."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from dds_trace.base.errors import TraceError
from dds_trace.base.units import format_duration
from dds_trace.recorder.host.recorder_cost import measure_recorder_cost
from dds_trace.recorder.rehearsal import rehearse
from dds_trace.recorder.roles.floor import measure_floor
from dds_trace.tracefile.recovery.recover import recover

if TYPE_CHECKING:
    from pathlib import Path

    from dds_trace.recorder.backends.node import NodeOptions
    from dds_trace.recorder.options import RecordOptions
    from dds_trace.recorder.roles.progress import PingProgress, RelayProgress


def recover_trace(path: Path) -> None:
    """Make a closed trace of the one at `path`; print its path and what was recovered.

    Raises:
        TraceFormatError: `path` is no trace of ours.
    """
    report = recover(path)
    if report.recovered is not None:
        print(f"Wrote {report.recovered}")
    print("\n".join(report.lines()))


def check_start(options: RecordOptions) -> None:
    """Start a recording as asked and end it before its first message; print that it can begin.

    Raises:
        TraceError: as recording would.
    """
    rehearse(options, _Notes())
    print(f"{'a relay' if options.ping is None else 'a ping'} can begin as asked")


class _Notes:
    """A `Watch` whose notes go to stderr."""

    def note(self, text: str) -> None:
        """Print a line."""
        print(text, file=sys.stderr)

    def progress(self, progress: PingProgress | RelayProgress) -> None:
        """Take nothing: a rehearsal has no progress."""


def report_own_cost(out: Path | None, backend: str, options: NodeOptions) -> None:
    """Print the recorder's own cost, and the client library's floor if its middleware is installed.

    Args:
        out: path whose folder holds the measured trace for a moment, since its disk may matter; None for the
            temporary folder.
        backend: backend whose floor is measured.
        options: options of the node that sends to itself.

    Raises:
        OutputError: no trace can be written there.
    """
    # A folder that recording would make lies on the disk of the one that will hold it.
    folder = None if out is None else next(each for each in out.absolute().parents if each.is_dir())
    cost = measure_recorder_cost(folder)
    # At 1 kHz caches are cold, as they are in a node; in a loop an event costs a fraction of it.
    print(f"recording an event: median {_us(cost.record_median_ns)}, p99 {_us(cost.record_p99_ns)}, ", end="")
    print(f"slowest {_us(cost.record_max_ns)} ({cost.events} events at 1 kHz)")
    cold = f", {_us(cost.cold_timer_ns)} at 1 kHz, taken off" if cost.cold_timer_ns else ""
    print(
        f"slowest ten events in a row: {_us(cost.stall_of_ten_ns)}; reading the clock: {_us(cost.timer_ns)}{cold}"
    )
    try:
        floor = measure_floor(backend, options)
    except TraceError as error:
        print(f"floor of the client library: not measured, {error}")
        return
    print(f"floor of the client library ({backend}, a node to itself, {floor.messages} messages): ", end="")
    print(f"median {_us(floor.median_ns)}, p99 {_us(floor.p99_ns)}")


def _us(duration_ns: float) -> str:
    return format_duration(duration_ns, "us")

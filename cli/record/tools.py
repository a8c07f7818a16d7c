"""Tools of `dds-record`: `--recover`, `--self-test` and `--check`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dds_trace.base.errors import TraceError
from dds_trace.base.streams import say
from dds_trace.base.units import format_duration
from dds_trace.recorder.host.recorder_cost import measure_recorder_cost
from dds_trace.recorder.recording import rehearse
from dds_trace.recorder.roles.floor import measure_floor

if TYPE_CHECKING:
    from pathlib import Path

    from dds_trace.recorder.backends.node import NodeOptions
    from dds_trace.recorder.options import RecordOptions
    from dds_trace.recorder.roles.progress import Progress


def recover_trace(path: Path, out: Path | None = None) -> None:
    from dds_trace.tracefile.recovery.recordings import is_of_others, recover_recording
    from dds_trace.tracefile.recovery.recover import recover  # reads traces: a recording needs no SQLite

    report = recover_recording(path, out) if is_of_others(path) else recover(path, out)
    if report.recovered is not None:
        print(f"Wrote {report.recovered}")
    print("\n".join(report.lines()))


def check_start(options: RecordOptions) -> None:
    rehearse(options, _Notes())
    role = "ping" if options.ping else "tap" if options.tap else "beacon" if options.beacon_rate_hz else "relay"
    print(f"a {role} can begin")


class _Notes:
    def note(self, text: str) -> None:
        say(text)

    def progress(self, progress: Progress) -> None:
        """Do nothing: a rehearsal has no progress."""


def report_own_cost(out: Path | None, backend: str, options: NodeOptions) -> None:
    # The nearest existing folder is on the same disk.
    folder = None if out is None else next(folder for folder in out.absolute().parents if folder.is_dir())
    cost = measure_recorder_cost(folder)
    # At 1 kHz caches are cold, as in a node.
    print(f"recording an event: median {_us(cost.record_median_ns)}, p99 {_us(cost.record_p99_ns)}, ", end="")
    print(f"slowest {_us(cost.record_max_ns)} ({cost.events} events at 1 kHz)")
    cold = f", {_us(cost.cold_timer_ns)} at 1 kHz, subtracted" if cost.cold_timer_ns else ""
    print(f"slowest ten events in a row: {_us(cost.stall_of_ten_ns)}; reading the clock: {_us(cost.timer_ns)}{cold}")
    try:
        floor = measure_floor(backend, options)
    except TraceError as error:
        print(f"floor of the client library: not measured, {error}")
        return
    print(f"floor of the client library ({backend}, a node to itself, {floor.messages} messages): ", end="")
    print(f"median {_us(floor.median_ns)}, p99 {_us(floor.p99_ns)}")


def _us(duration_ns: float) -> str:
    return format_duration(duration_ns, "us")

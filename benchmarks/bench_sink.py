"""The event sink against python `mcap` writing inline, side by side in one process: seven ratios with their bars.

    python benchmarks/bench_sink.py [--rounds 5] [--json]

Cold is one event, then a sleep, as in a node at 1 kHz; warm is one event behind the other. Exit code 1 if a bar is missed or a file is refused by the public reader. Absolute times are this machine's.
"""

from __future__ import annotations

import argparse
import json
import statistics
import struct
import sys
import tempfile
import time
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap.writer import Writer

from dds_trace.recorder.payloads.stamp import RAW_HEADER_STAMP
from dds_trace.recorder.roles.floor import (
    PACE_NS,
    measure_timer_ns,
    measuring_session,
    time_paced_events,
    worst_stall_ns,
)
from dds_trace.tracefile.format.encoding import CDR_HEADER
from dds_trace.tracefile.format.events import EVENT_DEFINITION, EVENT_SCHEMA_NAME, Stage
from dds_trace.tracefile.writing.destination import TraceDestination
from dds_trace.tracefile.writing.sink import TraceSink

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Record = Callable[[int, int, int, int], object]
    Stamp = Callable[[int, int, int], int]
    Recorder = Callable[[Path], AbstractContextManager[Record]]
    Stamper = Callable[[Path], AbstractContextManager[Stamp]]

BURST_EVENTS = 500
BURSTS = 40
PACED_EVENTS = 2_500
COLD_EVENTS = 1_000
BEFORE_PACED_EVENTS = 10_500  # python mcap closes a chunk each 11,500 events; let it come in the paced part
SUSTAINED_EVENTS = 300_000
HEADER_BYTES = 64


@contextmanager
def sink(path: Path) -> Iterator[Record]:
    """Our sink."""
    opened = TraceSink(TraceDestination(path), measuring_session())
    yield opened.record
    opened.close()


@contextmanager
def inline(path: Path) -> Iterator[Record]:
    """Python `mcap`, called where the event happens, with its defaults."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="benchmark")
        schema_id = writer.register_schema(EVENT_SCHEMA_NAME, "ros2msg", EVENT_DEFINITION.encode())
        channels = [0, *(writer.register_channel(stage.topic, "cdr", schema_id) for stage in Stage)]
        add_message, pack = writer.add_message, struct.Struct("<QQqqqqII").pack

        def record(stage: int, run_id: int, sequence: int, monotonic_ns: int) -> None:
            data = CDR_HEADER + pack(run_id, sequence, monotonic_ns, 0, 0, 0, 0, 0)
            add_message(channels[stage], monotonic_ns, data, monotonic_ns, sequence)

        yield record
        writer.finish()


@contextmanager
def stamping_sink(path: Path) -> Iterator[Stamp]:
    """Our sink, which reads the clock itself."""
    opened = TraceSink(TraceDestination(path), measuring_session())
    yield opened.stamp
    opened.close()


@contextmanager
def stamping_inline(path: Path) -> Iterator[Stamp]:
    """Python `mcap`, called between the time stamp and the message."""
    with inline(path) as record:

        def stamp(stage: int, run_id: int, sequence: int) -> int:
            stamped_ns = time.monotonic_ns()
            record(stage, run_id, sequence, stamped_ns)
            return stamped_ns

        yield stamp


RECORDERS: dict[str, Recorder] = {"sink": sink, "inline": inline}
STAMPERS: dict[str, Stamper] = {"sink": stamping_sink, "inline": stamping_inline}


def hot_path_ns(recorder: Recorder, path: Path) -> float:
    """Mean time of an event, the time stamp itself left out; bursts of events with pauses, as messages come."""
    now = time.monotonic_ns
    spent = 0
    with recorder(path) as record:
        for burst in range(BURSTS):
            begin = now()
            for sequence in range(burst * BURST_EVENTS, (burst + 1) * BURST_EVENTS):
                record(1, 1, sequence, now())
            spent += now() - begin
            time.sleep(0.002)
    return spent / (BURSTS * BURST_EVENTS) - measure_timer_ns()


def handover_ns(stamper: Stamper, path: Path) -> float:
    """Median time from a time stamp to the moment where its message could leave, bursts of events as above."""
    now = time.monotonic_ns
    times = []
    with stamper(path) as stamp:
        for burst in range(BURSTS):
            for sequence in range(burst * BURST_EVENTS, (burst + 1) * BURST_EVENTS):
                stamped_ns = stamp(1, 1, sequence)
                times.append(now() - stamped_ns)
            time.sleep(0.002)
    return statistics.median(times) - measure_timer_ns()


def publish_ns(stamper: Stamper, path: Path) -> float:
    """Median time from a time stamp to the publishing of a message whose header holds it, as a ping does it."""
    now, write_second = time.monotonic_ns, RAW_HEADER_STAMP.write_second
    write_nanoseconds = RAW_HEADER_STAMP.write_nanoseconds
    message, times = bytearray(HEADER_BYTES), []
    with stamper(path) as stamp:
        for burst in range(BURSTS):
            for sequence in range(burst * BURST_EVENTS, (burst + 1) * BURST_EVENTS):
                second_ns = write_second(message, now())
                stamped_ns = stamp(1, 1, sequence)
                write_nanoseconds(message, stamped_ns - second_ns)
                times.append(now() - stamped_ns)
            time.sleep(0.002)
    return statistics.median(times) - measure_timer_ns()


def cold_path_ns(recorder: Recorder, path: Path) -> float:
    """Median cost of one event, then a sleep, at 1 kHz: caches are as cold as a node's. Net of a reading of the clock likewise."""
    with recorder(path) as record:
        times, readings = time_paced_events(record, COLD_EVENTS)
    return statistics.median(times.tolist()) - statistics.median(readings.tolist())


def cold_handover_ns(stamper: Stamper, path: Path) -> float:
    """Median time from a time stamp to the moment where its message could leave, one event, then a sleep, at 1 kHz."""
    now, times, readings = time.monotonic_ns, [], []
    with stamper(path) as stamp:
        for sequence in range(COLD_EVENTS):
            time.sleep(PACE_NS / 1e9)
            stamped_ns = stamp(1, 1, sequence)
            times.append(now() - stamped_ns)
            time.sleep(PACE_NS / 1e9)
            stamped_ns = now()
            readings.append(now() - stamped_ns)
    return statistics.median(times) - statistics.median(readings)


def stall_ns(recorder: Recorder, path: Path) -> float:
    """Return the cost of the worst ten consecutive events at 1 kHz, without that of the time stamps."""
    now = time.monotonic_ns
    with recorder(path) as record:
        for sequence in range(BEFORE_PACED_EVENTS):
            record(1, 1, sequence, now())
        times, _ = time_paced_events(record, PACED_EVENTS)
    return worst_stall_ns(times - measure_timer_ns())


def sustained_per_s(recorder: Recorder, path: Path) -> float:
    """Events per second that end up in the file, as fast as they can be recorded, closing included."""
    now = time.monotonic_ns
    begin = now()
    with recorder(path) as record:
        for sequence in range(SUSTAINED_EVENTS):
            record(1, 1, sequence, now())
    seconds = (now() - begin) / 1e9
    return count_events(path) / seconds


def count_events(path: Path) -> int:
    """Events that the public reader finds, every CRC checked."""
    with path.open("rb") as stream:
        records = StreamReader(stream, validate_crcs=True).records
        return sum(isinstance(record, Message) and len(record.data) == 60 for record in records)


@dataclass(frozen=True)
class Bar:
    """A figure of both recorders and the ratio that it must reach."""

    name: str
    unit: str
    measure: Callable[[str, Path], float]
    at_most: float | None = None
    at_least: float | None = None

    def holds(self, ratio: float) -> bool:
        """Whether the ratio sink / inline is good enough."""
        return (self.at_most is None or ratio <= self.at_most) and (self.at_least is None or ratio >= self.at_least)


BARS = [
    Bar(
        "one event at 1 kHz (cold), median", "ns", lambda name, path: cold_path_ns(RECORDERS[name], path), at_most=1 / 2
    ),
    Bar(
        "stamp to hand-over at 1 kHz (cold)",
        "ns",
        lambda name, path: cold_handover_ns(STAMPERS[name], path),
        at_most=1 / 5,
    ),
    Bar("hot path, mean", "ns", lambda name, path: hot_path_ns(RECORDERS[name], path), at_most=1 / 5),
    Bar("stamp to hand-over, median", "ns", lambda name, path: handover_ns(STAMPERS[name], path), at_most=1 / 10),
    Bar(
        "stamp to publish with a header, median",
        "ns",
        lambda name, path: publish_ns(STAMPERS[name], path),
        at_most=1 / 7,
    ),
    Bar("worst stall of ten events at 1 kHz", "ns", lambda name, path: stall_ns(RECORDERS[name], path), at_most=1 / 20),
    Bar("sustained", "events/s", lambda name, path: sustained_per_s(RECORDERS[name], path), at_least=3),
]


@dataclass(frozen=True)
class Result:
    """Medians over the rounds; `ratio` is the median of the rounds' ratios."""

    name: str
    unit: str
    sink: float
    inline: float
    ratio: float
    bar: str
    holds: bool


def run_bar(bar: Bar, rounds: int, folder: Path) -> Result:
    """Measure both recorders in turn, so that what else the machine does meets both."""
    figures: dict[str, list[float]] = {name: [] for name in RECORDERS}
    for number in range(rounds):
        for name in RECORDERS:
            path = folder / f"{name}{number}.mcap"
            figures[name].append(bar.measure(name, path))
            count_events(path)
            path.unlink()
    ratio = statistics.median(ours / theirs for ours, theirs in zip(*figures.values(), strict=True))
    limit = f"<= 1/{1 / bar.at_most:.0f}" if bar.at_most is not None else f">= {bar.at_least}"
    sink_median, inline_median = (statistics.median(values) for values in figures.values())
    return Result(bar.name, bar.unit, sink_median, inline_median, ratio, limit, bar.holds(ratio))


def main() -> int:
    """Print the table; the exit code says whether every bar holds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--folder", type=Path, help="where the files go (default: the temporary folder)")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as scratch:
        results = [run_bar(bar, options.rounds, Path(scratch)) for bar in BARS]
    if options.json:
        print(json.dumps([asdict(result) for result in results], indent=2))
    else:
        print(f"{'':40}{'sink':>14}{'inline':>14}{'ratio':>10}{'bar':>10}")
        for result in results:
            ratio = f"{result.ratio:.2f}" if result.ratio >= 1 else f"1/{1 / result.ratio:.1f}"
            missed = "" if result.holds else "  MISSED"
            print(
                f"{result.name:40}{result.sink:>14,.0f}{result.inline:>14,.0f}{ratio:>10}{result.bar:>10}"
                f"  {result.unit}{missed}"
            )
    return 0 if all(result.holds for result in results) else 1


if __name__ == "__main__":
    sys.exit(main())

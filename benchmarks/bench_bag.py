"""Reading and recovering recordings of others, against the loop over messages of python `mcap`, and against unpacking alone.

    python benchmarks/bench_bag.py                  at a tenth of the size: a quick look, held against no bar
    python benchmarks/bench_bag.py --full           at full size, which the bars are for
    python benchmarks/bench_bag.py --full --against DIR --csv benchmarks/speed.csv    in turn with the checkout in DIR: `just bench-speed DIR`

Every figure is processor time of a process from its start to its end, less that of the same command for a recording of a few
messages. The loop is `for _ in make_reader(stream).iter_messages(): pass`. A ratio is the median over the rounds.

- *topics*: 1 kHz, 200 Hz and 100 Hz with stamps on a grid that arrive late by up to half a period.
- *camera*: the same with images of 300 KB at 30 Hz, not packed.
- *many*: 4,000 topics of 100 messages.
- *sqlite*, *ros1*: three tenths of *topics* in a database of rosbag2, and in a ROS 1 bag, against `bag` of the same in MCAP.

What is held against the loop or against MCAP is read by the other checkout with `--all` only: 413bda57 takes six minutes for *topics*.
"""

from __future__ import annotations

import argparse
import os
import sqlite3
import statistics
import struct
import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from commands import Ran, SpeedRow, keep_row, run_command
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Writer1

from dds_trace.extensions.bags.sqlite_rows import SQLITE_TABLES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

HERE = Path(__file__).parents[1]
START_NS = 1_790_000_000_000_123_457
SECONDS, CAMERA_SECONDS, MANY_TOPICS, MANY_SECONDS, FEW_SECONDS = 770.0, 100.0, 4000, 10.0, 0.2
QUICK_PART, OTHERS_PART = 0.1, 0.3
TOPICS = ((5_000_000, 300), (1_000_000, 120), (10_000_000, 1_000))
CAMERA = (33_333_333, 300_000)
MANY = (100_000_000, 100)
BARS = {
    "bag topics": 0.2,
    "bag camera": 0.5,
    "bag sqlite": 1.5,
    "bag ros1": 1.5,
    "recover topics": 0.6,
    "recover cut": 0.6,
}
BEFORE_BARS = {"bag many": 0.33}
WORDS = {
    "bag topics": "`bag`, three topics of 100 to 1,000 Hz",
    "bag camera": "`bag`, a camera of 300 KB among them, 0.94 GB",
    "bag many": "`bag`, 4,000 topics of 100 messages",
    "recover topics": "`recover` of the first",
    "recover cut": "`recover` of the first, cut in the middle",
    "bag sqlite": "`bag` of a database of rosbag2",
    "bag ros1": "`bag` of a ROS 1 bag",
}
MOST_BYTES_A_MESSAGE, MOST_BYTES_BESIDES = 100, 150e6
LOOP = "import sys; from mcap.reader import make_reader; [None for _ in make_reader(open(sys.argv[1], 'rb')).iter_messages()]"
RULE = "=" * 80
DEFINITION = (
    f"std_msgs/Header header\nuint8[] data\n{RULE}\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    f"{RULE}\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)


@dataclass(frozen=True)
class Recording:
    """A recording; the loop reads one that is not closed only as a `part` of the `whole`. One `like` another in MCAP is held against it."""

    path: Path
    messages: int
    whole: Path | None = None
    part: float = 1.0
    like: Path | None = None


def messages_of(seconds: float, topics: Sequence[tuple[int, int]]) -> Iterator[tuple[int, int, int, bytes]]:
    """Yield topic, log time, stamp and payload of messages by log time; each topic has a period (ns) and a payload (bytes)."""
    rng = np.random.default_rng(7)
    blob = rng.integers(0, 64, 400_000, dtype=np.uint8).tobytes()
    times, stamps, of_topic = [], [], []
    for number, (period_ns, _) in enumerate(topics):
        stamps.append(START_NS + number * 1000 + np.arange(max(int(seconds * 1e9 / period_ns), 1)) * period_ns)
        times.append(stamps[-1] + 2_000_000 + rng.integers(0, period_ns // 2, len(stamps[-1])))
        of_topic.append(np.full(len(stamps[-1]), number))
    time_ns, stamp_ns, topic = (np.concatenate(column) for column in (times, stamps, of_topic))
    for number, row in enumerate(np.argsort(time_ns, kind="stable").tolist()):
        size = topics[topic[row]][1]
        content = struct.pack("<4sI", b"cam\0", size) + blob[number % 1000 : number % 1000 + size]
        yield int(topic[row]), int(time_ns[row]), int(stamp_ns[row]), content


def write_recording(
    path: Path, seconds: float, topics: Sequence[tuple[int, int]] = TOPICS, *, is_packed: bool = True
) -> Recording:
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD if is_packed else CompressionType.NONE)
        writer.start("ros2", "made")
        schema = writer.register_schema("my_msgs/msg/Blob", "ros2msg", DEFINITION.encode())
        channels = [writer.register_channel(f"/t{number}", "cdr", schema) for number in range(len(topics))]
        number = -1
        for number, (topic, time_ns, stamp_ns, content) in enumerate(messages_of(seconds, topics)):
            writer.add_message(channels[topic], time_ns, cdr(stamp_ns, content), stamp_ns, number)
        writer.finish()
    return Recording(path, number + 1)


def cdr(stamp_ns: int, content: bytes) -> bytes:
    return b"\0\1\0\0" + struct.pack("<iII", *divmod(stamp_ns, 10**9), 4) + content


def write_database(path: Path, seconds: float, like: Recording) -> Recording:
    with sqlite3.connect(path) as database:
        database.executescript(SQLITE_TABLES)
        topics = [(number + 1, f"/t{number}", "my_msgs/msg/Blob", "cdr", "", "") for number in range(len(TOPICS))]
        database.executemany("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", topics)
        definition = (1, "my_msgs/msg/Blob", "ros2msg", DEFINITION, "")
        database.execute("INSERT INTO message_definitions VALUES (?, ?, ?, ?, ?)", definition)
        rows = ((topic + 1, at, cdr(stamp, content)) for topic, at, stamp, content in messages_of(seconds, TOPICS))
        database.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
    database.close()
    return Recording(path, like.messages, like=like.path)


def write_ros1(path: Path, seconds: float, like: Recording) -> Recording:
    definition = f"Header header\nuint8[] data\n{RULE}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    with Writer1(path) as bag:
        topics = [
            bag.add_connection(f"/t{number}", "my_msgs/msg/Blob", msgdef=definition, md5sum="0" * 32)
            for number in range(len(TOPICS))
        ]
        for number, (topic, time_ns, stamp_ns, content) in enumerate(messages_of(seconds, TOPICS)):
            bag.write(topics[topic], time_ns, struct.pack("<IIII", number, *divmod(stamp_ns, 10**9), 4) + content)
    return Recording(path, like.messages, like=like.path)


def cut_in_the_middle(whole: Recording) -> Recording:
    path = whole.path.with_name("cut.mcap")
    path.write_bytes(whole.path.read_bytes()[: whole.path.stat().st_size // 2])
    return Recording(path, whole.messages // 2, whole.path, 0.5)


def run_of(checkout: Path, command: str, recording: Path, out: Path) -> Ran:
    """Run a command of a checkout; the recordings are whole, and those that are not are recovered."""
    if command == "recover":
        out.unlink(missing_ok=True)
    arguments = [sys.executable, "-m", "dds_trace", command, os.fspath(recording), "--out", os.fspath(out)]
    return run_command(arguments, {"PYTHONPATH": os.fspath(checkout / "src")})


def main() -> int:
    """Print the table; return 1 if a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--full", action="store_true", help="recordings of full size")
    parser.add_argument("--against", type=Path, metavar="DIR", help="a checkout to measure in turn with this one")
    parser.add_argument(
        "--all", action="store_true", help="rows that are held against the loop or MCAP in turn with it, too"
    )
    parser.add_argument("--csv", type=Path, help="keep the rows there, for `python scripts/quoted.py`")
    parser.add_argument("--only", default="", help="rows with this in their name")
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    part = 1.0 if options.full else QUICK_PART
    missed = 0
    with tempfile.TemporaryDirectory(prefix="bench-bag-") as name:
        folder = Path(name)
        few = write_recording(folder / "few.mcap", FEW_SECONDS)
        seconds = SECONDS * part * OTHERS_PART
        topics = cache(lambda: write_recording(folder / "topics.mcap", SECONDS * part))
        like = cache(lambda: write_recording(folder / "like.mcap", seconds))
        rows: dict[str, Callable[[], Recording]] = {
            "bag topics": topics,
            "bag camera": lambda: write_recording(
                folder / "camera.mcap", CAMERA_SECONDS * part, (*TOPICS, CAMERA), is_packed=False
            ),
            "bag many": lambda: write_recording(folder / "many.mcap", MANY_SECONDS, (MANY,) * int(MANY_TOPICS * part)),
            "recover topics": topics,
            "recover cut": lambda: cut_in_the_middle(topics()),
            "bag sqlite": lambda: write_database(folder / "like.db3", seconds, like()),
            "bag ros1": lambda: write_ros1(folder / "like.bag", seconds, like()),
        }
        for row, write in rows.items():
            if options.only in row:
                against = options.against if options.all or row in BEFORE_BARS else None
                missed += measure(
                    row,
                    write(),
                    few,
                    options.rounds,
                    against,
                    options.csv if options.full else None,
                    is_full=options.full,
                )
    return min(missed, 1)


def measure(
    row: str,
    recording: Recording,
    few: Recording,
    rounds: int,
    against: Path | None,
    stored: Path | None = None,
    *,
    is_full: bool,
) -> int:
    """Print a row; return how many bars it misses."""
    command, out = row.split(maxsplit=1)[0], few.path.with_name("out.mcap" if row.startswith("recover") else "out")
    over_loop, over_before, ran_last, of_before = [], [], None, ""
    for _ in range(rounds):
        loops = [
            run_of(HERE, command, one, out)
            if recording.like
            else run_command([sys.executable, "-c", LOOP, os.fspath(one)], {})
            for one in (few.path, recording.like or recording.whole or recording.path)
        ]
        runs = [run_of(HERE, command, one.path, out) for one in (few, recording)]
        cpu_s, loop_s = (after.cpu_s - before.cpu_s for before, after in (runs, loops))
        over_loop.append(cpu_s / (loop_s * recording.part))
        ran_last = runs[1]
        if against is not None:
            before = [run_of(against, command, one.path, out) for one in (few, recording)]
            before_s = before[1].cpu_s - before[0].cpu_s
            over_before.append(cpu_s / before_s)
            of_before = f"; {statistics.median(over_before):.3f} of the {before_s:.2f} s, {before[1].peak_bytes / 1e6:.0f} MB before"
    assert ran_last is not None
    ratio, bar, peer = statistics.median(over_loop), BARS.get(row), "MCAP" if recording.like else "the loop"
    most_bytes = MOST_BYTES_BESIDES + MOST_BYTES_A_MESSAGE * recording.messages
    print(
        f"{row}: {recording.messages:,} messages, {ran_last.cpu_s:.2f} s of a core with its start, {ran_last.peak_bytes / 1e6:.0f} MB; "
        f"{ratio:.2f} of {peer}{f' (at most {bar})' if bar else ''}{of_before}",
        flush=True,
    )
    over, over_bar = statistics.median(over_before) if over_before else None, BEFORE_BARS.get(row)
    bars = {"over_peer": bar, "over_before": over_bar, "peak_mb": round(most_bytes / 1e6)}
    name = f"{WORDS[row]}: {recording.messages:,} messages"
    asked = " ".join(f"{figure}={most}" for figure, most in bars.items() if most)
    keep_row(stored, SpeedRow(name, ran_last.cpu_s, ran_last.peak_bytes / 1e6, peer, ratio, over, asked))
    is_slower = over is not None and over_bar is not None and over > over_bar
    return is_full * ((bar is not None and ratio > bar) + is_slower + (ran_last.peak_bytes > most_bytes))


if __name__ == "__main__":
    sys.exit(main())

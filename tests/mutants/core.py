"""The core, whose mistakes would change a result without a word: its modules and the tests that are to see a mutant of them."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Part:
    """Modules (files, or folders with all their files) and the tests that run for a mutant of one of them."""

    modules: tuple[str, ...]
    tests: tuple[str, ...]


CORE = {
    "pairing": Part(("analyzer/pairing",), ("tests/analyzer/pairing", "tests/analyzer/test_unsent_messages.py")),
    "spool": Part(("analyzer/loading/spool.py", "analyzer/loading/traces.py"), ("tests/analyzer/loading",)),
    "results": Part(
        ("analyzer/engines/batches.py",), ("tests/analyzer/loading/test_traces.py", "tests/analyzer/engines")
    ),
    "stamps": Part(("recorder/payloads/stamp.py",), ("tests/recorder/payloads",)),
    "statistics": Part(
        ("analyzer/statistics", "analyzer/run_statistics", "extensions/gates/detectable.py"),
        ("tests/analyzer/statistics", "tests/analyzer/run_statistics", "tests/analyzer/verdicts"),
    ),
    "intervals": Part(("analyzer/groups/intervals.py",), ("tests/analyzer/groups",)),
    "clocks": Part(("analyzer/clocks",), ("tests/analyzer/clocks",)),
    "ring": Part(
        ("tracefile/format/ring.py", "tracefile/format/events.py"),
        (
            "tests/tracefile/format",
            "tests/tracefile/reading/test_reader_ring.py",
            "tests/tracefile/writing/test_sink.py",
        ),
    ),
    "sink": Part(
        ("tracefile/writing/sink.py", "tracefile/writing/packing.py", "tracefile/writing/event_chunks.py"),
        ("tests/tracefile/writing", "tests/extensions/topics/test_taps.py"),
    ),
    "gates": Part(
        ("extensions/gates/gate.py", "extensions/gates/gates.py"),
        ("tests/extensions/gates", "tests/extensions/bags/test_drives.py"),
    ),
    "answers": Part(("analyzer/verdicts/answers.py", "analyzer/verdicts/ranking.py"), ("tests/analyzer/verdicts",)),
    "headline": Part(
        tuple(f"reports/book/{name}.py" for name in ("answer", "fastest", "headline", "losses")),
        ("tests/reports/book", "tests/extensions/gates/test_interference.py"),
    ),
    "applied": Part(("recorder/applied/differences.py",), ("tests/recorder/applied",)),
    # `process.py` runs in a process of its own, which no trial reaches.
    "wire": Part(
        (
            *(f"extensions/wire/{name}.py" for name in ("capture", "counts", "messages", "ring", "tally")),
            *(f"extensions/wire/{name}.py" for name in ("classes", "frames", "packet_filter", "rtps")),
            "recorder/kernel/sockets.py",
        ),
        ("tests/extensions/wire", "tests/recorder/kernel"),
    ),
}

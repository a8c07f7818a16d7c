"""Fuzz what reads the bytes of strangers, guided by coverage (atheris); tests run the same targets for a second each.

    just fuzz 600 plan                                                # seconds, and a target of the table below
    python tests/fuzz/fuzz.py plan CORPUS_FOLDER -max_total_time=600  # in TMPDIR; libFuzzer's options
    python tests/fuzz/fuzz.py plan crash-0123abcd                     # a find, tried again

A target says in its module what may come of an input: a result, or an error of ours that names the file. It never
crashes, hangs (more than ten seconds for one input) or takes memory without bound (1 GB). Finds become tests beside the
module that they are about; of the reader in `tests/tracefile/reading/test_reader_finds.py`.
"""

import sys
import tempfile
from importlib import import_module
from pathlib import Path
from typing import Protocol

TARGETS = {
    "reader": "fuzz_reader",
    "descriptions": "fuzz_descriptions",
    "plan": "fuzz_plan",
    "bag": "fuzz_bag",
    "bag1": "fuzz_bag1",
    "logs": "fuzz_logs",
    "limits": "fuzz_limits",
    "state": "fuzz_state",
    "ring": "fuzz_ring",
    "watch": "fuzz_watch",
    "peers": "fuzz_peers",
    "strangers": "fuzz_strangers",
}
"""Name of a target -> its module, whose class `Target` is a `FuzzTarget`."""

INSTRUMENTED = [
    "dds_trace.tracefile",
    "dds_trace.analyzer",
    "dds_trace.cli.defaults",
    "dds_trace.extensions.gates.limits_file",
    "dds_trace.recorder.backends.socket",
    "dds_trace.recorder.payloads",
    "dds_trace.recorder.roles",
    "dds_trace.extensions.bags",
    "dds_trace.extensions.campaigns.plan",
    "dds_trace.extensions.campaigns.run.state",
    "dds_trace.extensions.topics",
    "dds_trace.reports",
]
"""Modules whose branches libFuzzer sees."""

LIMITS = ["-timeout=10", "-rss_limit_mb=1024", "-max_len=16384"]


class FuzzTarget(Protocol):
    def seeds(self) -> dict[str, bytes]:
        """Return good inputs by name."""

    def try_input(self, data: bytes) -> None:
        """Do with one input what the product does; raise what no user may see."""


def open_target(name: str, folder: Path) -> FuzzTarget:
    target: FuzzTarget = import_module(TARGETS[name]).Target(folder)
    return target


def main() -> None:
    import atheris

    name, *arguments = sys.argv[1:] or [""]
    if name not in TARGETS:
        raise SystemExit(f"no target {name!r}; choose from {', '.join(TARGETS)}")
    sys.path[:0] = [str(Path(__file__).parents[1] / "support")]
    with tempfile.TemporaryDirectory(prefix=f"fuzz-{name}-") as folder:
        with atheris.instrument_imports(include=INSTRUMENTED):
            target = open_target(name, Path(folder))
        corpora = [Path(argument) for argument in arguments if not argument.startswith("-")]
        if corpora and not corpora[0].is_file():
            corpora[0].mkdir(parents=True, exist_ok=True)
            for seed, data in target.seeds().items():
                (corpora[0] / f"seed-{seed}").write_bytes(data)
        atheris.Setup([sys.argv[0], *LIMITS, *arguments], target.try_input)
        atheris.Fuzz()


if __name__ == "__main__":
    main()

"""Cut and damage recordings at random places, recover each, and read the result with the official MCAP reader and with rosbags.

Usage: bench_recover.py [--files 10000] [--seed 1]. Prints a line for each kind of file; ends with 1 if a whole message is lost.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from damaged_bags import KINDS, Good, damage, make_good, read_recovered

from dds_trace.base.errors import TraceFormatError
from dds_trace.tracefile.recovery.recordings import recover_recording


def main() -> int:
    """Run all kinds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    lost = 0
    with tempfile.TemporaryDirectory() as folder:
        for number, kind in enumerate(KINDS):
            rng = random.Random(options.seed + number)
            files = (options.files + number) // len(KINDS)
            lost += _run(make_good(kind, Path(folder), options.seed), files, rng, Path(folder))
    return 1 if lost else 0


def _run(good: Good, files: int, rng: random.Random, folder: Path) -> int:
    path = folder / ("x.db3" if good.kind == "sqlite3" else "x.mcap")
    whole_messages = recovered = lost = nothing = 0
    seconds = 0.0
    for _ in range(files):
        content, whole = damage(good, rng)
        path.write_bytes(content)
        before = time.perf_counter()
        try:
            report = recover_recording(path)
        except TraceFormatError:
            nothing += 1
            lost += len(whole)
            continue
        finally:
            seconds += time.perf_counter() - before
        messages = read_recovered(report.recovered)
        report.recovered.unlink()
        whole_messages += len(whole)
        recovered += len(messages)
        lost += len(whole - messages)
    print(
        f"{good.kind}: {files} files, {whole_messages} whole messages, {lost} of them lost, {recovered} recovered, "
        f"{nothing} files without any; {1000 * seconds / files:.1f} ms a file",
        flush=True,
    )
    return lost


if __name__ == "__main__":
    sys.exit(main())

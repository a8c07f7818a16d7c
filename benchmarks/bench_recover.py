"""Cut and damage recordings at random places, recover each, and read the result with the official MCAP reader and with rosbags.

Usage: bench_recover.py [--files 10000] [--seed 1]. Prints a line for each kind of file; ends with 1 if a whole message is lost.
"""

from __future__ import annotations

import argparse
import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from damaged_bags import HOWS, KINDS, Good, damage, make_good, read_recovered

from dds_trace.base.errors import TraceFormatError
from dds_trace.extensions.bags.recover import recover_recording


def main() -> int:
    """Run all kinds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", default="", help="only kinds with this in their name")
    options = parser.parse_args()
    lost = 0
    for number, kind in enumerate(KINDS):
        if options.kind not in kind:
            continue
        rng = random.Random(options.seed + number)
        files = (options.files + number) // len(KINDS)
        with tempfile.TemporaryDirectory() as folder:  # the log of another kind would be read
            lost += _run(make_good(kind, Path(folder), options.seed), files, rng, Path(folder))
    return 1 if lost else 0


def _run(good: Good, files: int, rng: random.Random, folder: Path) -> int:
    whole_messages = recovered = nothing = 0
    lost = Counter[str]()
    seconds = 0.0
    for number in range(files):
        how = HOWS[number % len(HOWS)]
        content, whole = damage(good, rng, how)
        path = good.write(folder, content)
        before = time.perf_counter()
        try:
            report = recover_recording(path)
        except TraceFormatError:
            nothing += 1
            lost[how] += len(whole)
            continue
        finally:
            seconds += time.perf_counter() - before
        messages = read_recovered(report.recovered)
        report.recovered.unlink()
        whole_messages += len(whole)
        recovered += len(messages)
        lost[how] += len(whole - messages)
    print(
        f"{good.kind}: {files} files, {whole_messages} whole messages, {lost.total()} of them lost, {recovered} recovered, "
        f"{nothing} files without any; {1000 * seconds / files:.1f} ms a file",
        *(f"{how}: {count} lost" for how, count in lost.items() if count),
        sep="\n  ",
        flush=True,
    )
    return lost.total()


if __name__ == "__main__":
    sys.exit(main())

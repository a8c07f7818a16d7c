"""Minutes and setup of `dds-trace advise` against its predecessor, which asked one vendor at a time, and against all candidates.

    python benchmarks/bench_advise.py OUT [--links ethernet second wifi lte] [--old SRC] [--grid 0] [--json FILE]

Root, Linux. SRC is the folder `src` of a checkout before the command took `--size`, whose `.venv` is used if it has one (its programs
may start in another module); without SRC only the new one is timed. Then the
new answer, the best file of each vendor of the old one, and with `--grid N` all candidates run N times in turns; what is printed is
the geometric mean of p50 and p99 of the response and the share received. An interrupted run goes on with the same command.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from dds_trace.extensions.campaigns.halving import Candidate, Limits, Race, Standing
from dds_trace.extensions.campaigns.plan.link import Link
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.question import find_candidates
from dds_trace.extensions.campaigns.trials import open_trials

LINKS = {
    "ethernet": Link("ethernet", rate_mbit_s=100),
    "second": Link("second", rate_mbit_s=25, delay_ms=5, loss_percent=0.5),
    "wifi": Link("wifi", rate_mbit_s=54, delay_ms=1, jitter_ms=0.5, loss_percent=1, loss_burst=8),
    "lte": Link("lte", rate_mbit_s=20, delay_ms=25, jitter_ms=8, loss_percent=0.1, queue_ms=300),
}
RUN_SECONDS, FRESH = 8.0, 5

PLAN = """\
[run]
seconds = 2
min_messages = 20
warmup = 5
repeats = 5
order = "alternating"
settle_seconds = 0.2
cutoff_seconds = 6
[link]
{link}
[axes]
backend = ["ros2", "cyclonedds", "zenoh"]
data = "binary"
size = "{size}"
rate = {rate}
"""


def write_plan(path: Path, link: Link, size: str, rate: float) -> Path:
    """Write the question as a plan, which both versions of the command read."""
    values = {key: value for key, value in link.to_dict().items() if value}
    path.write_text(
        PLAN.format(link="\n".join(f"{k} = {json.dumps(v)}" for k, v in values.items()), size=size, rate=rate)
    )
    return path


def timed(command: list[str], kept: Path, python: str = sys.executable, **variables: str) -> tuple[float, object]:
    """Return minutes and JSON output of a command, those of an earlier run if it is through."""
    if not kept.exists():
        began_s = time.monotonic()
        done = subprocess.run(
            [python, "-m", "dds_trace", *command],
            stdout=subprocess.PIPE,
            text=True,
            check=False,
            env={**os.environ, **variables},
        )
        if done.returncode not in (0, 10):
            raise SystemExit(f"{' '.join(command)} ended with {done.returncode}")
        kept.write_text(json.dumps([(time.monotonic() - began_s) / 60, json.loads(done.stdout)]))
    minutes, found = json.loads(kept.read_text())
    return minutes, found


def run_in_turns(plan_path: Path, candidates: list[Candidate], folder: Path, runs: int) -> list[Standing]:
    """Record fresh runs of all candidates in turns; return them, best first."""
    limits = Limits()
    plan = parse_plan(plan_path.read_text(), "fresh", str(plan_path))
    with open_trials(plan, folder, print, RUN_SECONDS) as trials:
        race = Race(trials, limits, math.inf, lambda _: None, stage="fresh")
        standings = [Standing(candidate) for candidate in candidates]
        for number in range(runs):
            for standing in standings if number % 2 == 0 else reversed(standings):
                if not standing.dropped:
                    race.run(standing, RUN_SECONDS)
    return sorted(standings, key=lambda standing: standing.rank(limits))


def row(standing: Standing) -> dict[str, object]:
    """Describe what was measured of a candidate in fresh runs."""
    if not standing.looks:
        return {"setup": standing.candidate.name, "dropped": standing.dropped}
    values = np.concatenate(standing.responses())
    p50, p99 = np.quantile(values, (0.5, 0.99), method="higher").tolist()
    return {
        "setup": standing.candidate.name,
        "p50_ms": p50,
        "p99_ms": p99,
        "level_ms": math.exp(standing.level),
        "received": float(np.isfinite(values).mean()),
    }


def main() -> None:
    """Time both commands on each link, and run what they found in turns."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--links", nargs="+", choices=LINKS, default=list(LINKS))
    parser.add_argument("--size", default="145KB")
    parser.add_argument("--rate", type=float, default=8)
    parser.add_argument("--minutes", default="10")
    parser.add_argument("--old", type=Path, help="folder `src` of a checkout of the predecessor")
    parser.add_argument("--grid", type=int, default=0, help="runs of every candidate")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    results = []
    for name in options.links:
        plan = write_plan(options.out / f"{name}.toml", LINKS[name], options.size, options.rate)
        out = ["--out", str(options.out / name)]
        minutes, found = timed(
            ["advise", str(plan), "--minutes", options.minutes, "--json", *out], options.out / f"{name}.new.json"
        )
        chosen = {(found["recommended"]["vendor"], found["recommended"]["bundle"])}
        result = {"link": name, "minutes": minutes, "sentence": found["sentence"]}
        old = {}
        if options.old:
            old_minutes, advices = timed(
                ["advise", str(plan), "--json", "--out", str(options.out / f"{name}-old")],
                options.out / f"{name}.old.json",
                str(own if (own := options.old.parent / ".venv/bin/python").exists() else sys.executable),
                PYTHONPATH=str(options.old),
            )
            old = {one["vendor"]: Path(one["configuration"]).stem if one["kept"] else "" for one in advices}
            result |= {"old_minutes": old_minutes, "old": old}
        asked = parse_plan(plan.read_text(), "fresh", str(plan))
        every = find_candidates(asked, asked.link, options.out / name / "fresh-configurations")
        wanted = chosen | set(old.items())
        fresh = [one for one in every if options.grid or (one.vendor, one.bundle) in wanted]
        ranking = run_in_turns(plan, fresh, options.out / name / "fresh", options.grid or FRESH)
        new = next(one for one in ranking if (one.candidate.vendor, one.candidate.bundle) in chosen)
        result |= {"fresh": [row(one) for one in ranking], "times_the_best": math.exp(new.level - ranking[0].level)}
        results.append(result)
        print(json.dumps(result, indent=1), flush=True)
        if options.json:
            options.json.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()

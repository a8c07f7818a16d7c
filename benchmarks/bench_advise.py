"""`dds-trace advise` on emulated links drawn with a seed: is what it keeps ever worse than the default in runs of its own?

    python benchmarks/bench_advise.py OUT [--seed 39] [--links 6] [--json FILE]

Root, Linux. A kept file is measured again against the default, interleaved, in five repeats that the advice did not see. An
interrupted run goes on with the same command.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
from pathlib import Path

from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.campaigns.proof import compared
from dds_trace.extensions.gates.compare import compare

BACKENDS = ("ros2", "cyclonedds", "zenoh")
SIZES_KB = (33, 145, 502)
MOST_LOAD = 0.4
"""Share of the link's rate that the payload takes in one direction at most."""

PLAN = """\
[run]
seconds = 2
min_messages = 20
warmup = 5
repeats = 5
order = "alternating"
settle_seconds = 0.2
cutoff_seconds = 6
[devices.ping]
options = ["--realtime", "50", "--no-own-cost"]
[devices.relay]
options = ["--realtime", "50", "--no-own-cost"]
[link]
name = "link-{number}"
rate_mbit_s = {rate_mbit_s}
delay_ms = {delay_ms}
queue_ms = {queue_ms}
loss_percent = {loss_percent}
[axes]
backend = "{backend}"
data = "binary"
size = "{size_kb}KB"
rate = {rate_hz}
{further}"""


def draw_link(seed: int, number: int) -> dict[str, object]:
    """Return a link and a load, different ones for each number."""
    rng = random.Random(f"{seed}.{number}")
    rate_mbit_s = round(10 * 20 ** rng.random(), 1)
    size_kb = rng.choice(SIZES_KB)
    rate_hz = max(2, min(30, int(MOST_LOAD * rate_mbit_s * 1000 / (8 * size_kb))))
    return {
        "number": number,
        "backend": BACKENDS[number % len(BACKENDS)],
        "rate_mbit_s": rate_mbit_s,
        "delay_ms": round(0.5 * 40 ** rng.random(), 1),
        "queue_ms": rng.choice((30, 100, 200)),
        "loss_percent": rng.choice((0, 0.05, 0.2, 1)),
        "size_kb": size_kb,
        "rate_hz": rate_hz,
    }


def _sweep(*arguments: str) -> str:
    command = [str(Path(sys.executable).with_name("dds-trace")), *arguments]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=False)
    if done.returncode not in (0, 10):
        raise SystemExit(f"{' '.join(command)} ended with {done.returncode}")
    return done.stdout


def judge(link: dict[str, object], advice: dict[str, object], out: Path) -> dict[str, object]:
    """Measure the kept file against the default in fresh runs; return the changes and how many are worse by their interval."""
    plans = []
    for name, further in (("default", ""), ("kept", f"configuration = {json.dumps(advice['configuration'])}")):
        plans.append(out / f"{name}-{link['number']}.toml")
        plans[-1].write_text(PLAN.format(**link, further=further))
    _sweep("sweep", str(plans[0]), "--against", str(plans[1]), "--out", str(out))
    folder = out / f"{plans[0].stem}-against-{plans[1].stem}"
    comparison = compare(*(analyze(folder / side, details=False) for side in ("base", "new")), compared())
    changes = comparison.rows.select("statistic", "base_ns", "new_ns", "ratio", "ratio_low", "ratio_high").rows(
        named=True
    )
    received = comparison.delivery.select("base_received_ratio", "new_received_ratio", "difference_high").rows(
        named=True
    )
    worse = [row["statistic"] for row in changes if (row["ratio_low"] or 0) > 1]
    worse += ["received" for row in received if (row["difference_high"] or 0) < 0]
    return {"changes": changes, "received": received, "worse": worse}


def main() -> None:
    """Advise and judge link after link; print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seed", type=int, default=39)
    parser.add_argument("--links", type=int, nargs="+", default=list(range(6)), help="numbers of the links")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    results = []
    for number in options.links:
        link = draw_link(options.seed, number)
        plan = options.out / f"link-{number}.toml"
        plan.write_text(PLAN.format(**link, further=""))
        found = json.loads(_sweep("advise", str(plan), "--json", "--out", str(options.out)))
        advice = found["recommended"] or {}
        judged = judge(link, advice, options.out) if advice.get("configuration") else None
        results.append(
            {
                "link": link,
                "answer": {key: found[key] for key in ("sentence", "candidates", "proofs", "fits", "seconds")},
                "judged": judged,
            }
        )
        print(
            number,
            link["backend"],
            found["sentence"],
            "worse:" if judged else "",
            judged["worse"] if judged else "",
            flush=True,
        )
        if options.json:
            options.json.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()

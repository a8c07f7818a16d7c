"""Chaos: sweeps over all backends and bridges while things go wrong, until the time is over; one line a round.

    just chaos 30                                    # minutes
    python tests/chaos/chaos.py --seed 17 --rounds 1 # one round again, as a failing one prints it

A round is a small plan and its faults, drawn from a seed (`chaos_draw.py`): processes killed or stopped, Ctrl-C, a full or
slow disk, a link that is down. `dds-trace sweep` is called until every cell is complete. After each call (`chaos_checks.py`) the
exit code is true, complete cells stayed, no process, shared memory, namespace or file is left; at the end every cell has
every event that was stamped for it, once. A round has its own mounts, `/dev/shm`, network and processes; it needs root.
"""

import argparse
import itertools
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

SEED = 1
OWN_WORLD = ("unshare", "--mount", "--net", "--pid", "--fork", "--mount-proc", "--kill-child")
LONGEST_ROUND_S = 1500.0


def play_round(seed: int, folder: Path, only: Sequence[str] = ()) -> dict[str, object]:
    """Play the round of a seed in an empty folder, over these BACKEND:BRIDGE or all that run here; return its line."""
    words = [*OWN_WORLD, sys.executable, Path(__file__).with_name("chaos_round.py"), str(seed), folder, *only]
    with (folder / "round.log").open("wb") as log:
        # Ctrl-C is for this process; the kernel ends the round with it.
        process = subprocess.Popen(
            words,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
            env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[1] / "support")},
        )
        try:
            process.wait(LONGEST_ROUND_S)
        except BaseException:
            process.send_signal(signal.SIGKILL)
            process.wait()
            raise
    try:
        line: dict[str, object] = json.loads((folder / "round.json").read_text())
    except FileNotFoundError:
        line = {"seed": seed, "wrong": [(folder / "round.log").read_text(errors="replace")[-2000:]]}
    return line


def line_of(line: dict[str, object]) -> str:
    words = {name: _shown(value) for name, value in line.items() if name not in ("wrong", "seed")}
    verdict = "FAILED" if line["wrong"] else "ok"
    return f"{line['seed']:>6} {verdict:6} " + "  ".join(f"{name} {value}" for name, value in words.items())


def _shown(value: object) -> str:
    return ",".join(map(str, value)) or "-" if isinstance(value, list) else str(value)


def main() -> None:
    """Play rounds until the time, or their number, is over; exit code 1 if one failed."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("minutes", type=float, nargs="?", default=float("inf"), help="no round begins later")
    parser.add_argument("--seed", type=int, default=SEED, help="of the first round; each has the next")
    parser.add_argument("--rounds", type=int, help="how many at most")
    parser.add_argument("--only", action="append", default=[], metavar="BACKEND:BRIDGE", help="repeatable")
    arguments = parser.parse_args()
    if os.geteuid() != 0:
        raise SystemExit("chaos needs root: a round has namespaces of its own")
    out = Path(tempfile.mkdtemp(prefix="dds-trace-chaos-"))
    end = time.monotonic() + arguments.minutes * 60
    failed = played = 0
    for seed in itertools.count(arguments.seed):
        if time.monotonic() >= end or played == arguments.rounds:
            break
        folder = out / str(seed)
        folder.mkdir()
        line = play_round(seed, folder, arguments.only)
        played += 1
        print(line_of(line), flush=True)
        if not line["wrong"]:
            shutil.rmtree(folder)
            continue
        failed += 1
        for reason in line["wrong"]:  # type: ignore[attr-defined]
            print(f"       {reason}", flush=True)
        again = [sys.executable, __file__, "--seed", str(seed), "--rounds", "1"]
        again += [word for pair in arguments.only for word in ("--only", pair)]
        print(f"       kept in {folder}; again: {shlex.join(again)}", flush=True)
    print(f"{played} rounds from seed {arguments.seed} on, {failed} failed")
    if not failed:
        out.rmdir()
    raise SystemExit(bool(failed))


if __name__ == "__main__":
    main()

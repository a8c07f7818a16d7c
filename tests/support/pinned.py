"""What every statistic says of a few drawn campaigns; run it to write these numbers anew, after a deliberate change.

python tests/support/pinned.py
"""

import json
from collections.abc import Callable
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drawn_series import change_of_runs, log_normal_groups
from pinned_series import SERIES

from dds_trace.analyzer.clocks.fit import RelayedMessages, fit_clocks
from dds_trace.analyzer.clocks.slews import slewed_ppm
from dds_trace.analyzer.run_statistics.between_runs import interval_of_runs
from dds_trace.analyzer.run_statistics.modes import find_modes, find_trend, find_warm_up
from dds_trace.analyzer.run_statistics.received import change_of_received, received_interval
from dds_trace.analyzer.run_statistics.runs import MEAN, Run, Statistic
from dds_trace.analyzer.run_statistics.spread import runs_to_settle_ratio, runs_to_settle_value, spread_of_runs
from dds_trace.analyzer.statistics.power import messages_to_close, runs_to_decide

FOLDER = Path(__file__).parents[1] / "data" / "pinned"
SECOND_NS = 1_000_000_000
STEPPED = {"smallest_ratio": 5e-3}
"""Numbers that are read off a step, and their relative steps: the last digit of a sum on another processor takes the next one."""
STATISTICS = {"mean": MEAN, "p50": Statistic(0.5), "p90": Statistic(0.9), "p99": Statistic(0.99)}


def campaigns() -> dict[str, list[Any]]:
    """Runs by campaign, in ms: alike, correlated, in bursts, with losses, two modes, few messages, one run."""
    independent = log_normal_groups(1, 4, 400, 0.05, seed=5)[0]
    correlated = log_normal_groups(1, 3, 700, 0.1, seed=6, correlation=0.8)[0]
    draw = np.random.default_rng(7)
    bursts, losses = independent.copy(), independent.copy()
    for run in range(4):
        for begin in draw.integers(0, 380, 3):
            bursts[run, begin : begin + draw.integers(2, 20)] *= 6
        losses[run, draw.integers(0, 400, 9)] = np.inf
        losses[run, 50 + 60 * run : 58 + 60 * run] = np.inf
    return {
        "independent": list(independent),
        "correlated": list(correlated),
        "bursts": list(bursts),
        "losses": list(losses),
        "two modes": list(np.where(draw.random((4, 400)) < 0.3, 4, 1) * independent),
        "short": list(log_normal_groups(1, 5, 45, 0.2, seed=8)[0]),
        "one run": [correlated[0]],
    }


def detectors(name: str) -> dict[str, Any]:
    """What the functions of one run, and of what was received, say of a campaign."""
    values = campaigns()[name]
    received, whole = [np.isfinite(each) for each in values], [np.arange(400) % 97 > 0] * 3
    first = values[0][received[0]]
    return {
        "trend": find_trend(first),
        "warm-up": find_warm_up(np.where(np.arange(len(first)) < 30, 3.0, 1.0) * first),
        "modes": find_modes(np.sort(first)),
        "received": [received_interval(received, level) for level in (0.95, 0.8)],
        "change of received": change_of_received(whole, received),
    }


def of_statistic(name: str, statistic: str) -> dict[str, Any]:
    """What is said of one statistic of a campaign, alone and beside the independent one."""
    values, base, one = campaigns()[name], campaigns()["independent"], STATISTICS[statistic]
    runs, others = [Run(each) for each in values], [Run(1.1 * each) for each in base[: len(values)]]
    order = tuple(range(len(runs)))
    interval, change = interval_of_runs(runs, one), change_of_runs(others, runs, one)
    return {
        "interval": [interval, interval_of_runs(runs, one, 0.8), interval_of_runs(runs[:1], one)],
        "spread": spread_of_runs(runs, one),
        "change": [change, change_of_runs(runs, others, one, 0.8)],
        "paired": change_of_runs(others, runs, one, passes=(order[: len(others)], order)),
        "settle": [runs_to_settle_ratio(change, 2.0), runs_to_settle_value(interval, 2.0)],
        "close": None if one.quantile is None else messages_to_close(interval, one.quantile),
    }


def power() -> list[Any]:
    return [runs_to_decide(0.07, 0.05, 0.02), runs_to_decide(0.3, 0.1, 0.1, 0.8)]


def clocks() -> dict[str, Any]:
    """Fits of two clocks that part steadily, are stepped, are slewed, sit on one machine, or have few messages."""
    said: dict[str, Any] = {}
    for number, (name, messages, rate_hz, drift_ppb, step_ns, slew_ppm) in enumerate(
        (
            ("steady", 700, 20, 3_000, 0, 0),
            ("stepped", 400, 10, -40_000, 2_000_000, 0),
            ("slewed", 900, 10, 1_000, 0, 480),
            ("few", 3, 1, 500, 0, 0),
            ("one", 1, 1, 0, 0, 0),
        )
    ):
        draw = np.random.default_rng([9, number])
        sent = 40 * 86_400 * SECOND_NS + np.arange(messages) * (SECOND_NS // rate_hz)
        arrived, left = (
            sent + draw.exponential(200_000, messages).astype(np.int64) + each for each in (90_000, 130_000)
        )
        left = np.maximum(left, arrived)
        back = left + 110_000 + draw.exponential(600_000, messages).astype(np.int64)

        theta = partial(_theta, int(sent[0]), int(sent[-1]), drift_ppb, step_ns, slew_ppm)
        stamps = sent, arrived + theta(arrived), left + theta(left), back
        ((fit, offsets),) = fit_clocks([RelayedMessages(*stamps)])
        raw = sent - theta(sent)
        said[name] = {
            "fit": fit,
            "offsets": [offsets.offset_ns[::29].tolist(), offsets.bound_ns[::29].tolist()],
            "slewed": slewed_ppm(sent[::rate_hz], raw[::rate_hz]),
        }
    one = np.array([1_000, 2_000, 3_500])
    same = fit_clocks(
        [RelayedMessages(one, one, one, one + 10, same_boot=True), RelayedMessages(one, one + 1, one + 2, one + 9)]
    )
    said["one machine"] = [fit for fit, _ in same]
    return said


def _theta(begin: int, end: int, drift_ppb: int, step_ns: int, slew_ppm: int, at: Any) -> Any:
    """What the relay's clock is ahead: a drift, a jump halfway, fifteen seconds of a slew from the twentieth on."""
    gained = np.clip(at - begin - 20 * SECOND_NS, 0, 15 * SECOND_NS) * slew_ppm / 1e6
    jumped = (at >= (begin + end) // 2) * step_ns
    return 7_000_000 + np.rint((at - begin) * drift_ppb / 1e9 + gained + jumped).astype(np.int64)


PINNED: dict[str, dict[str, Callable[[], Any]]] = {
    "statistics": {
        **{name: partial(detectors, name) for name in campaigns()},
        **{f"{name}, {one}": partial(of_statistic, name, one) for name in campaigns() for one in STATISTICS},
        "power": power,
    },
    "series": SERIES,
    "clocks": {"clocks": clocks},
}


def assert_pinned(file: str, name: str) -> None:
    """Whole numbers and words are what they were, others within the error of their arithmetic."""
    pinned = _flat(json.loads((FOLDER / f"{file}.json").read_text())[name])
    found = _flat(_plain(PINNED[file][name]()))
    measured = {path for path, each in pinned.items() if isinstance(each, float)}
    assert {path: each for path, each in found.items() if path not in measured} == {
        path: each for path, each in pinned.items() if path not in measured
    }
    for path in measured:
        error = STEPPED.get(path.rpartition("/")[2], 1e-7)
        assert found[path] == pytest.approx(pinned[path], rel=error, abs=1e-12), path


def _plain(held: Any) -> Any:
    if hasattr(held, "__dataclass_fields__"):
        return _plain({name: getattr(held, name) for name in held.__dataclass_fields__})
    if hasattr(held, "_asdict"):
        return _plain(held._asdict())
    if isinstance(held, dict):
        return {str(name): _plain(each) for name, each in held.items()}
    if isinstance(held, list | tuple):
        return [_plain(each) for each in held]
    if isinstance(held, Enum):
        return held.value
    return held.item() if isinstance(held, np.generic) else held


def _flat(held: Any, path: str = "") -> dict[str, Any]:
    parts = held.items() if isinstance(held, dict) else enumerate(held) if isinstance(held, list) else None
    if parts is None:
        return {path: held}
    return {name: each for key, part in parts for name, each in _flat(part, f"{path}/{key}").items()}


if __name__ == "__main__":
    for kind, parts in PINNED.items():
        lines = (f"{json.dumps(name)}: {json.dumps(_plain(numbers()))}" for name, numbers in parts.items())
        (FOLDER / f"{kind}.json").write_text("{\n" + ",\n".join(lines) + "\n}\n")

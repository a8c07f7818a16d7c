"""What the simulations of the coverage share: drawn results, and tables with the bars that they miss."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from dds_trace.analyzer.model.parameters import PARAMETER_COLUMNS
from dds_trace.analyzer.run_statistics.between_runs import Estimate, Units, ends_of_units
from dds_trace.analyzer.statistics.intervals import Basis, Interval

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    Float64 = NDArray[np.float64]
    Bools = NDArray[np.bool_]
    DrawLosses = Callable[[np.random.Generator, int, int, float], Bools]


SEED = 20_261_128
"""Of every table."""


@dataclass(slots=True)
class Table:
    """Rows of percents, and the bars that they miss by more than two standard errors of the simulation."""

    name: str
    columns: tuple[str, ...]
    rows: list[tuple[str, ...]] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)

    def at_most(self, bar: float, count: int, samples: int, what: str) -> str:
        """Return a share in percent, held against its bar."""
        if count / samples > bar + 2 * math.sqrt(bar * (1 - bar) / samples):
            self.missed.append(f"{self.name}, {what}: {count / samples:.1%}, at most {bar:.1%}")
        return percent(count, samples)

    def at_least(self, bar: float, count: int, samples: int, what: str) -> str:
        """Return a share in percent, held against its bar."""
        if count / samples < bar - 2 * math.sqrt(bar * (1 - bar) / samples):
            self.missed.append(f"{self.name}, {what}: {count / samples:.1%}, at least {bar:.1%}")
        return percent(count, samples)

    def markdown(self) -> Iterator[str]:
        """Return the lines of the table."""
        for row in (self.columns, ("---",) * len(self.columns), *self.rows):
            yield f"| {' | '.join(row)} |"

    def write(self, folder: Path) -> None:
        """Write `coverage-NAME.csv`."""
        with (folder / f"coverage-{self.name}.csv").open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([self.columns, *self.rows])


def percent(count: int, samples: int) -> str:
    """Return a share in percent."""
    return f"{100 * count / samples:.1f}" if samples else "-"


def single_losses(generator: np.random.Generator, runs: int, messages: int, share: float) -> Bools:
    """Draw which messages are lost, one by one; shape (runs, messages)."""
    return generator.random((runs, messages)) < share


def unlike_losses(generator: np.random.Generator, runs: int, messages: int, share: float) -> Bools:
    """Draw single losses of runs whose shares vary by half."""
    shares = share * np.exp(0.5 * generator.standard_normal((runs, 1)) - 0.125)
    return generator.random((runs, messages)) < shares


def outages(generator: np.random.Generator, runs: int, messages: int, share: float, together: int) -> Bools:
    """Draw outages of so many messages, which begin at any message."""
    begins = generator.random((runs, messages + together - 1)) < share / together
    seen = np.cumsum(np.pad(begins, ((0, 0), (1, 0))), axis=1)
    return seen[:, together:] > seen[:, :-together]


LOSSES: dict[str, DrawLosses] = {
    "single losses": single_losses,
    "shares +-50 %": unlike_losses,
    **{f"outages of {together}": partial(outages, together=together) for together in (4, 20, 40, 100)},
}


def draw_values(
    generator: np.random.Generator, runs: int, messages: int, spread: float, deviation: float = 0.5
) -> Float64:
    """Draw log-normal messages of runs whose levels vary; shape (runs, messages)."""
    within = deviation * generator.standard_normal((runs, messages))
    return np.exp(within + spread * generator.standard_normal((runs, 1)))


def draw_pareto(generator: np.random.Generator, runs: int, messages: int) -> Float64:
    """Draw messages with a heavy tail, of runs that vary by 5 %; shape (runs, messages)."""
    return (1 + 0.3 * generator.pareto(1.5, (runs, messages))) * np.exp(0.05 * generator.standard_normal((runs, 1)))


PARAMETERS = {
    **{column.name: "any" if column.dtype == pl.String else 1 for column in PARAMETER_COLUMNS},
    "bridge": "none",
    "domain_mode": "same",
    "rate_hz": 100.0,
    "setting": "",
}


def round_trips(times: Float64, **parameters: str) -> pl.DataFrame:
    """Return messages at 100 Hz whose latency is that many ms, infinite for a lost one; shape (results, runs, messages).

    The results differ in `payload_bytes`, from 1 on.
    """
    results, runs, messages = times.shape
    latency = np.where(np.isfinite(times), 1e6 * times, np.nan).ravel()
    of_run = np.arange(results * runs).repeat(messages)
    schema = {column.name: column.dtype for column in PARAMETER_COLUMNS}
    values = {name: pl.lit(value, schema[name]) for name, value in {**PARAMETERS, **parameters}.items()}
    return pl.DataFrame(
        {
            "run_id": of_run,
            "publish_ns": 10_000_000 * np.arange(times.size),
            "latency_ns": latency,
            "rtt_ns": 2 * latency,
            "response_ns": 2 * latency,
            "outcome": np.where(np.isnan(latency), "lost", "completed"),
        }
    ).with_columns(
        **values | {"payload_bytes": pl.Series(1 + of_run // runs, dtype=schema["payload_bytes"])},
        **{name: pl.col(name).fill_nan(None) for name in ("latency_ns", "rtt_ns", "response_ns")},
    )


def estimate_of(values: Float64, confidence: float = 0.95) -> Estimate:
    """Return the estimate of a statistic whose values in the runs are these."""
    value, lower, upper, spread = ends_of_units(values, confidence)
    runs, messages = len(values), 1000 * len(values)
    interval = Interval(
        value,
        lower,
        upper,
        confidence,
        messages,
        messages,
        Basis.BETWEEN_RUNS,
        runs,
        runs,
        messages,
        unit_spread=spread,
    )
    return Estimate(interval, Units(values, messages, messages, runs, messages))

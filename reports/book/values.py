"""The numbers of `summary`, column by column, as figures and tables look them up by group."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from .groups import METRICS, STATISTICS

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dds_trace.analyzer.analysis import Analysis

RATIOS_AND_RATES = ("received_ratio", "achieved_rate_hz", "transfer_rate_bytes_per_s")
COUNTS = (
    "published",
    "received",
    "lost_outbound",
    "lost_in_relay",
    "lost_return",
    "lost_unknown",
    "duplicates",
    "reordered",
)


@dataclass(frozen=True, slots=True)
class Values:
    """Every number of `summary`; position i of every tuple is group i, None where there is no value.

    Attributes:
        times_ns: metric -> statistic -> ns, rounded to whole nanoseconds.
        plain: the other columns by name (`RATIOS_AND_RATES`, `COUNTS`).
    """

    times_ns: Mapping[str, Mapping[str, tuple[int | None, ...]]]
    plain: Mapping[str, tuple[float | None, ...]]

    def has(self, metric: str) -> bool:
        """Whether any group has a value of the metric."""
        return any(value is not None for column in self.times_ns[metric].values() for value in column)

    def timed(self, group: int) -> bool:
        """Whether the group has a time of any metric: whether anything came back."""
        return any(columns["max"][group] is not None for columns in self.times_ns.values())

    @property
    def default_metric(self) -> str:
        """What a page shows first: the latency, or the next metric that was measured at all."""
        return next((metric for metric in METRICS if self.has(metric)), "latency")


def values_info(analysis: Analysis) -> Values:
    """The numbers of `analysis.summary`."""
    return Values(
        times_ns={
            metric: {
                statistic: tuple(
                    None if value is None else round(value)
                    for value in _column(analysis, f"{metric}_{statistic}_ns")
                )
                for statistic in STATISTICS
            }
            for metric in METRICS
        },
        plain={name: _column(analysis, name) for name in (*RATIOS_AND_RATES, *COUNTS)},
    )


def _column(analysis: Analysis, name: str) -> tuple[float | None, ...]:
    """A column without NaN or infinity; both mean that there is no number."""
    return tuple(
        value if value is not None and math.isfinite(value) else None
        for value in analysis.summary[name].to_list()
    )

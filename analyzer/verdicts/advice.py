"""Whether settings of a middleware pay: how they look over a few runs, and what a comparison with the default proves."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import polars as pl

if TYPE_CHECKING:
    from collections.abc import Mapping

    from .compare import Comparison

LOST_NS = 10_000_000_000
"""Response of a lost message in a first look."""


def first_look(messages: pl.DataFrame, tried: Mapping[int, tuple[str, int]]) -> dict[str, float]:
    """Return configuration -> geometric mean of p50 and p99 of the response over its results, ns.

    `tried` is id of a run -> configuration and number of its result.
    """
    schema: Any = {"run_id": messages.schema["run_id"], "configuration": pl.String, "result": pl.Int64}
    names = pl.DataFrame([(run_id, *names) for run_id, names in tried.items()], schema, orient="row")
    response = pl.col("response_ns").fill_null(LOST_NS)
    level = (response.quantile(0.5).log() + response.quantile(0.99).log()) / 2
    results = messages.join(names, on="run_id").group_by("configuration", "result").agg(level.alias("level"))
    return dict(results.group_by("configuration").agg(pl.col("level").mean().exp()).rows())


def pays(comparison: Comparison) -> bool:
    if comparison.barred or len(comparison.only_base) or comparison.delivery["is_dead"].any():
        return False
    verdicts = {*comparison.rows["verdict"], *comparison.delivery["verdict"]}
    slower = comparison.rows["ratio_low"].fill_null(-math.inf) > 1
    fewer = comparison.delivery["difference_high"].fill_null(math.inf) < 0
    return "better" in verdicts and "worse" not in verdicts and not (slower.any() or fewer.any())

"""The cost of a bridge: communication between two domains compared with communication in one, for equal parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import polars as pl

from ..model.parameters import BRIDGE_MATCH_COLUMNS
from ..statistics.percentiles import PERCENTILES
from .cases import GroupRows, is_too_large, partition_groups
from .compare import CompareOptions, compare_groups
from .matching import match_groups

_OPTIONS = CompareOptions(metrics=("latency",), statistics=tuple(p.name for p in PERCENTILES), paired=True)


def find_bridge_costs(rows: GroupRows, passes: Mapping[int, int] | None = None) -> pl.DataFrame:
    across = (pl.col("domain_mode") == "different").any()
    within = ((pl.col("domain_mode") == "same") & (pl.col("bridge") == "none")).any()
    costs = [
        bridge_cost(rows.frame(case), _OPTIONS, passes)
        for case in partition_groups(rows.groups, BRIDGE_MATCH_COLUMNS)
        if case.select(across & within).item() and not is_too_large(case)
    ]
    empty = bridge_cost(rows.frame(rows.groups.head(0)), _OPTIONS)
    return pl.concat([empty, *costs]).sort("bridge", maintain_order=True)


def bridge_cost(
    roundtrips: pl.DataFrame, options: CompareOptions | None = None, passes: Mapping[int, int] | None = None
) -> pl.DataFrame:
    options = options or CompareOptions()
    match = tuple(name for name in options.match if name in BRIDGE_MATCH_COLUMNS)
    within = (pl.col("domain_mode") == "same") & (pl.col("bridge") == "none")
    same = match_groups(roundtrips.filter(within), match)
    different = roundtrips.filter(pl.col("domain_mode") == "different")
    tables = []
    for bridge in [*different["bridge"].unique().sort(), None]:  # None: no rows, but the columns
        through = match_groups(different.filter(pl.col("bridge").eq_missing(pl.lit(bridge, pl.String))), match)
        comparison = compare_groups(same, through, roundtrips.schema, replace(options, match=match), passes)
        tables.append(comparison.rows.select(pl.lit(bridge, pl.String).alias("bridge"), pl.all()))
    return pl.concat(tables)

"""Devices as strata: times of two devices are never pooled or compared, unless one replaced the other."""

from __future__ import annotations

from typing import TYPE_CHECKING

import polars as pl

if TYPE_CHECKING:
    from collections.abc import Mapping

DEVICE_COLUMNS = ("ping_device", "relay_device")


def replaced_devices(base: pl.DataFrame, new: pl.DataFrame) -> Mapping[str, str]:
    """Return the name that a device of the new side takes for a comparison: column -> name on the base.

    Devices are matched by name. Only where each side has a single ping device and a single relay device can no other
    one be meant: then the new device stands for the old one, and what changed with it is part of the comparison. A
    relay without a trace has no name and is no second device.

    Args:
        base: round trips or groups of the base, with `DEVICE_COLUMNS`.
        new: those of the new side.
    """
    names = {column: (_names(base, column), _names(new, column)) for column in DEVICE_COLUMNS}
    if any(len(side) > 1 for sides in names.values() for side in sides):
        return {}
    return {column: before[0] for column, (before, after) in names.items() if before and after}


def with_devices(frame: pl.DataFrame, names: Mapping[str, str]) -> pl.DataFrame:
    """Return a frame whose devices have these names; an unknown device stays unknown."""
    return frame.with_columns(
        pl.when(pl.col(column).is_not_null()).then(pl.lit(name)).alias(column)
        for column, name in names.items()
    )


def _names(frame: pl.DataFrame, column: str) -> list[str]:
    return [str(name) for name in frame[column].drop_nulls().unique().sort()]

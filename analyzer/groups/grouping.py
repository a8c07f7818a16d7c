"""Groups: exchanges that agree in every parameter, whatever their run or relay."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import polars as pl

from ..model.column import schema_of
from ..model.parameters import PARAMETER_COLUMNS, Parameters

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from ..pairing.exchanges import Exchange


@dataclass(frozen=True, slots=True, eq=False)
class Grouping:
    """Exchanges with equal parameters are one group; groups are sorted by their parameters, null last.

    Attributes:
        parameters: the parameter columns of each group.
        exchanges: by group, then as they came (by start of the run, then by relay).
        group_of_exchange: uint32, rising: for each exchange the position of its group.
    """

    parameters: pl.DataFrame
    exchanges: tuple[Exchange, ...]
    group_of_exchange: NDArray[np.uint32]

    def members(self) -> list[list[int]]:
        """Return for each group the positions of its exchanges."""
        members: list[list[int]] = [[] for _ in range(self.parameters.height)]
        for exchange, group in enumerate(self.group_of_exchange.tolist()):
            members[group].append(exchange)
        return members


def group_exchanges(exchanges: Sequence[Exchange]) -> Grouping:
    """Put exchanges that agree in every parameter into one group."""
    keys = [exchange.parameters() for exchange in exchanges]
    groups = sorted(set(keys), key=Parameters.order)
    number = {key: group for group, key in enumerate(groups)}
    group_of_exchange = np.array([number[key] for key in keys], np.uint32)
    order = np.argsort(group_of_exchange, kind="stable")
    return Grouping(
        pl.DataFrame([key.values() for key in groups], schema=schema_of(PARAMETER_COLUMNS), orient="row"),
        tuple(exchanges[position] for position in order.tolist()),
        group_of_exchange[order],
    )

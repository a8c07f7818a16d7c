"""The reports show an analysis; this room does not import them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

from dds_trace.base.extension import load

if TYPE_CHECKING:
    from plotly.graph_objects import Figure


class Presenter(Protocol):
    """Functions of the module that the part `presenter` is."""

    def first_screen(self, analysis: Any) -> str: ...

    def comparison_screen(self, comparison: Any) -> str:
        """Return the answer of a comparison and its results as HTML."""

    def plot(self, analysis: Any, name: str, *, panels: str | None, metric: str | None, statistic: str) -> Figure: ...

    def show(self, analysis: Any, folder: Path | None) -> Path:
        """Write the report and open it."""


def presenter() -> Presenter:
    return cast("Presenter", load("parts", "presenter"))

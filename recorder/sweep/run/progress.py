"""How far a sweep is, for a person (rich, on a terminal) or a log (plain lines)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from dds_trace.tracefile.units.counts import counted

if TYPE_CHECKING:
    from rich.console import Console

    from ..plan.schedule import Remaining


class SweepProgress(Protocol):
    """Hears what a sweep does."""

    def begin(self, cells: int, done: int) -> None:
        """The sweep has this many cells, of which some were done before; 0 cells if nobody knows how many."""

    def relay(self, name: str) -> None:
        """A relay is being started."""

    def cell(self, name: str, remaining: Remaining) -> None:
        """A cell begins."""

    def ended(self, name: str, outcome: str, *, complete: bool) -> None:
        """A cell is through: its result in words, or why it failed."""

    def note(self, text: str) -> None:
        """Something that a person should read."""

    def end(self) -> None:
        """The sweep is over."""


class PlainProgress:
    """A line for each cell."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._cells = self._done = 0

    def begin(self, cells: int, done: int) -> None:
        """Remembers the numbers."""
        self._cells, self._done = cells, done
        if done:
            self.note(f"{done} of {counted(cells, 'cell is', 'cells are')} there already")

    def relay(self, name: str) -> None:
        """One line."""
        self.note(f"relay: {name}")

    def cell(self, name: str, remaining: Remaining) -> None:
        """Says nothing: the line comes with the outcome."""

    def ended(self, name: str, outcome: str, *, complete: bool) -> None:
        """One line."""
        self._done += complete
        of = f"/{self._cells}" if self._cells else ""
        self.note(f"[{self._done}{of}] {name}: {outcome}")

    def note(self, text: str) -> None:
        """One line; never markup, as it may hold what a program said."""
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def end(self) -> None:
        """Nothing is open."""


class RichProgress(PlainProgress):
    """The same lines above a bar with the cell that runs, the time left and the last percentiles."""

    def __init__(self, console: Console) -> None:
        super().__init__(console)
        self._progress = Progress(
            TextColumn("{task.fields[cell]}"),
            BarColumn(bar_width=20),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}"),
            TextColumn("{task.fields[last]}"),
            console=console,
            transient=True,
        )
        self._task = self._progress.add_task("sweep", cell="", left="", last="")

    def begin(self, cells: int, done: int) -> None:
        """Shows the bar."""
        super().begin(cells, done)
        self._progress.update(self._task, total=cells or None, completed=done)
        self._progress.start()

    def cell(self, name: str, remaining: Remaining) -> None:
        """Shows the cell and the time left."""
        self._progress.update(self._task, cell=name, left=f"{remaining} left")

    def ended(self, name: str, outcome: str, *, complete: bool) -> None:
        """The line, and the bar moves."""
        super().ended(name, outcome, complete=complete)
        self._progress.update(self._task, completed=self._done, last=outcome.split(",", maxsplit=1)[0])

    def end(self) -> None:
        """The bar goes."""
        self._progress.stop()


def make_progress(console: Console) -> SweepProgress:
    """Whichever suits where the text goes."""
    return RichProgress(console) if console.is_terminal else PlainProgress(console)

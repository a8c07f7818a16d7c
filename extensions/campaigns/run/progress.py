"""The progress of a sweep, for a terminal or a log."""

from __future__ import annotations

import textwrap

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Column

from dds_trace.base.printable import MAX_FINDING_CHARACTERS, printable
from dds_trace.base.streams import SCREEN_WIDTH, plain_console, wrapped
from dds_trace.base.units import counted

from ..plan.schedule import Remaining

CELL_WIDTH = 25


class SweepProgress:
    """Receiver of the steps of a sweep; ignores them."""

    def begin(self, cells: int, complete: int) -> None:
        """Start with the number of cells (0: not fixed), and of complete ones."""

    def relay(self, name: str) -> None: ...

    def cell(self, name: str, remaining: Remaining) -> None: ...

    def ended(self, name: str, outcome: str, *, complete: bool) -> None:
        """Show a cell's result, or the reason of its failure."""

    def note(self, text: str) -> None: ...

    def end(self) -> None: ...


class PlainProgress(SweepProgress):
    def __init__(self, console: Console) -> None:
        self._console = console
        self._cells = self._complete = 0
        self._reasons: set[str] = set()

    def begin(self, cells: int, complete: int) -> None:
        self._cells, self._complete = cells, complete
        if complete:
            self.note(f"{complete} of {counted(cells, 'recording is', 'recordings are')} there already")

    def relay(self, name: str) -> None:
        self.note(f"relay: {name}")

    def ended(self, name: str, outcome: str, *, complete: bool) -> None:
        self._complete += complete
        total = f"/{self._cells}" if self._cells else ""
        words = "failed for the same reason" if outcome in self._reasons else outcome
        self._reasons |= set() if complete else {outcome}
        line = printable(f"[{self._complete}{total}] {name}: {words}", MAX_FINDING_CHARACTERS)
        for part in textwrap.wrap(
            line, SCREEN_WIDTH, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False
        ):
            self.note(part)

    def note(self, text: str) -> None:
        line = wrapped(printable(text, MAX_FINDING_CHARACTERS))
        self._console.print(line, markup=False, highlight=False, soft_wrap=True)


class RichProgress(PlainProgress):
    def __init__(self, console: Console) -> None:
        super().__init__(console)
        self._progress = Progress(
            TextColumn("{task.fields[cell]}", markup=False, table_column=Column(no_wrap=True, max_width=CELL_WIDTH)),
            BarColumn(bar_width=10),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}", markup=False),
            console=console,
            transient=True,
        )
        self._task = self._progress.add_task("sweep", cell="", left="")

    def begin(self, cells: int, complete: int) -> None:
        super().begin(cells, complete)
        self._progress.update(self._task, total=cells or None, completed=complete)
        self._progress.start()

    def cell(self, name: str, remaining: Remaining) -> None:
        self._progress.update(self._task, cell=name, left=f"{remaining} left")

    def ended(self, name: str, outcome: str, *, complete: bool) -> None:
        super().ended(name, outcome, complete=complete)
        self._progress.update(self._task, completed=self._complete)

    def end(self) -> None:
        self._progress.stop()


def make_progress(console: Console | None = None) -> SweepProgress:
    console = console or plain_console(stderr=True)
    return RichProgress(console) if console.is_terminal else PlainProgress(console)

"""An analysis as `analyze` and `choose` run it: a bar, the answer, files, and the page."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dds_trace.base import limits
from dds_trace.base.extension import load
from dds_trace.base.streams import plain_console, say

from .outputs import expand_paths, print_figures, show_page
from .program import ask_about_folder

if TYPE_CHECKING:
    from dds_trace.analyzer.analysis import Analysis

HTML, TERMINAL = "html", "terminal"
"""Kinds of report: `--open` opens a page, and the answer is always printed."""


def run_analysis(
    paths: Sequence[str],
    out: Path | None,
    report: Sequence[str] | None,
    more: Mapping[str, Any],
    *,
    exports: Sequence[str] | None = None,
    derived_mcap: bool = False,
    figures: Sequence[str] | None = None,
    open_it: bool = False,
    shows_all: bool = False,
) -> Analysis:
    from dds_trace.analyzer.exports.kinds import export as write_export
    from dds_trace.analyzer.loading.place import default_output
    from dds_trace.analyzer.pairing.parquet import read_provenance
    from dds_trace.analyzer.pipeline import WRITING, analyze
    from dds_trace.analyzer.saving.results import RESULT_NAMES
    from dds_trace.reports.reporters import write_reports

    limits.check(limits.FOLDER, None if out is None else str(out), "--out")
    traces = expand_paths(paths)
    target = default_output(traces) if out is None else out
    ask_about_folder(target, "for all files")
    kinds = list(dict.fromkeys([*(report or []), *([HTML] if open_it or figures else [])]))
    written: list[Path] = []

    def write_more(analysis: Analysis, folder: Path) -> None:
        bar.step(WRITING, 0.0)
        reports = write_reports(analysis, [kind for kind in kinds if kind != TERMINAL], folder)
        exported = [path for kind in exports or [] for path in write_export(analysis, kind, folder)]
        derived = _write_derived(analysis, folder) if derived_mcap else []
        files = [*reports, *exported, *derived]
        written.extend(target / path.name for path in files if path is not None)

    earlier = read_provenance(target)
    with AnalysisBar() as bar:
        analysis = analyze(traces, out=target, progress=bar.reading, step=bar.step, **more, write_more=write_more)
    write_reports(analysis, [TERMINAL], target, shows_all=shows_all)
    written[:0] = analysis.outputs.values()
    written += [path for kind in figures or () for path in print_figures(target / f"report.{HTML}", kind)]
    for path in written:
        print(f"Wrote {path}")
    stale = [name for name in RESULT_NAMES if target / name not in written and (target / name).is_file()]
    if stale and earlier is not None and earlier != read_provenance(target):
        say(f"{target}: {', '.join(stale)}: of an earlier analysis of other traces, and not replaced")
    show_page([path for path in written if path.suffix == ".html"], open_it=open_it)
    return analysis


def _write_derived(analysis: Analysis, target: Path) -> list[Path]:
    from dds_trace.analyzer.clocks.boots import ping_wall_offsets

    wall = ping_wall_offsets(analysis.sessions, analysis.runs)
    derived = load("parts", "derived")(analysis.load_roundtrips(), target / "latency.derived.mcap", wall, force=True)
    return [derived.path, derived.layout]


SHARES = {"reading": 0.3, "pairing": 0.35, "judging": 0.2, "writing": 0.15}
"""Share of the time of each step, of 300 to 1,500 runs."""


class AnalysisBar:
    def __init__(self) -> None:
        self.share = 0.0
        self._progress: Any = None

    def __enter__(self) -> AnalysisBar:  # noqa: PYI034 - `Self` is Python 3.11's
        if sys.stderr.isatty():
            from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

            columns = (
                TextColumn("{task.description}", markup=False),
                BarColumn(),
                TaskProgressColumn(),
                TimeElapsedColumn(),
            )
            console = plain_console(stderr=True)
            self._progress = Progress(*columns, console=console, transient=True, redirect_stdout=False)
            self._progress.add_task("reading", total=1.0)
            self._progress.start()
        return self

    def __exit__(self, *error: object) -> None:
        if self._progress is not None:
            self._progress.stop()

    def reading(self, done: int, total: int, path: Path) -> None:
        self._draw("reading", done / total, f"reading {path.name[:30]}")

    def step(self, name: str, share: float) -> None:
        self._draw(name, share, name)

    def _draw(self, name: str, share: float, words: str) -> None:
        names = list(SHARES)
        self.share = max(self.share, sum(SHARES[step] for step in names[: names.index(name)]) + SHARES[name] * share)
        if self._progress is not None:
            self._progress.update(self._progress.tasks[0].id, completed=self.share, description=words)

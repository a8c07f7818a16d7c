"""Recorder and analyzer for the latency of ROS 2 / DDS communication.

    from dds_trace import analyze
    a = analyze("runs/")

Analyze:

- `analyze`: analyze every trace in a folder.
- `Analysis`: everything that was computed from one folder of traces.
- `Details`: what is computed in addition to rows and summary.
- `Finding`: a doubtful measurement, and what to do about it.
- `Severity`: how much a finding should change a reader's trust in the numbers.
- `Source`: one file or folder that was looked at.
- `load_analysis`: read an analysis that `Analysis.save` wrote.
- `write_reports`: write reports of an analysis (`html`, `md`, `json`, `terminal`).
- `export_tables`: write rows and summary as CSV or Arrow.
- `write_derived`: write per-message latency as an MCAP for Foxglove and PlotJuggler.
- `analyze_topics`: analyze the topics of recordings that are not ours.

Compare:

- `compare`: compare every result that two analyses have in common.
- `CompareOptions`: how two sides are compared.
- `Comparison`: the results that two sides have in common, and those that only one side has.
- `Gate`: a condition under which a comparison fails.
- `parse_gate`: read a gate such as `latency_p99 > +10%`.
- `judge_gates`: the outcome of every gate in every matched result.
- `GateOutcome`: the outcome of a gate, with its exit code.
- `Job`: messages to send, and the latency that they need.
- `make_job`: make one of words: `make_job(size="502KB", rate="20", deadline="50ms", reliability="0.999")`.
- `Recommendation`: the settings for a job, best first.

Traces:

- `find_traces`: find every trace in a folder.
- `read_trace`: read a trace, or what is left of one.
- `iter_event_batches`: read the events of a trace in batches that fit into memory.
- `recover`: write a whole trace from what a killed recorder left.
- `Trace`: the sessions, runs and events of one trace.
- `EventColumns`: events as numpy columns.
- `Stage`: T1 to T4, where a message was stamped.
- `Session`: one recording process, as it describes itself.
- `Run`: one run, as its ping describes it.
- `TraceError`: what a user can act on; the base of all errors below.
- `TraceFormatError`: bytes on disk that do not follow the trace format.
- `MissingEventsError`: nothing that could be analyzed.
- `OptionError`: a value that is wrong or impossible.
- `OutputError`: an output cannot be written.

Every name is imported at its first use: `import dds_trace` loads neither numpy nor polars, and an analysis machine needs
no ROS 2. The rooms are folders at the top level of the repository, linked next to this file; a wheel contains the folders.
"""

import ast
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .analyzer.analysis import Analysis, Details, load_analysis
    from .analyzer.exports.kinds import export_tables
    from .analyzer.model.finding import Finding, Severity, Source
    from .analyzer.pipeline import analyze
    from .analyzer.verdicts.job import Job, make_job
    from .analyzer.verdicts.recommend import Recommendation
    from .base.errors import MissingEventsError, OptionError, OutputError, TraceError, TraceFormatError
    from .base.version import __version__
    from .extensions.bags.analyze import analyze_topics
    from .extensions.bags.recover_trace import recover
    from .extensions.exports.foxglove import write_derived
    from .extensions.gates.compare import CompareOptions, Comparison, compare
    from .extensions.gates.gate import Gate, GateOutcome, parse_gate
    from .extensions.gates.gates import judge_gates
    from .reports.reporters import write_reports
    from .tracefile.format.descriptions import Run, Session
    from .tracefile.format.events import EventColumns, Stage
    from .tracefile.reading.reader import iter_event_batches, read_trace
    from .tracefile.reading.storage import find_traces
    from .tracefile.reading.trace import Trace
else:

    @cache
    def _homes() -> dict[str, str]:
        """Return the module of each name that the block above imports (PEP 562)."""
        tree = ast.parse(Path(__file__).read_text(encoding="utf-8"))
        block = next(block for block in tree.body if isinstance(block, ast.If))
        return {alias.name: f".{line.module}" for line in block.body for alias in line.names}

    def __getattr__(name: str) -> object:
        if name not in _homes():
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = globals()[name] = getattr(import_module(_homes()[name], __name__), name)
        return value

    def __dir__() -> list[str]:
        return sorted({*globals(), *_homes()})


__all__ = [
    "Analysis",
    "CompareOptions",
    "Comparison",
    "Details",
    "EventColumns",
    "Finding",
    "Gate",
    "GateOutcome",
    "Job",
    "MissingEventsError",
    "OptionError",
    "OutputError",
    "Recommendation",
    "Run",
    "Session",
    "Severity",
    "Source",
    "Stage",
    "Trace",
    "TraceError",
    "TraceFormatError",
    "__version__",
    "analyze",
    "analyze_topics",
    "compare",
    "export_tables",
    "find_traces",
    "iter_event_batches",
    "judge_gates",
    "load_analysis",
    "make_job",
    "parse_gate",
    "read_trace",
    "recover",
    "write_derived",
    "write_reports",
]

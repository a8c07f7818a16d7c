"""What a recording says on stderr: notes as lines and, on a terminal, one line that is drawn anew twice a second."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from rich.console import Console
from rich.live import Live
from rich.text import Text

from dds_trace.recorder import PingProgress, RelayProgress
from dds_trace.tracefile.units.counts import counted
from dds_trace.tracefile.units.durations import format_duration

if TYPE_CHECKING:
    from types import TracebackType


def describe_progress(progress: PingProgress | RelayProgress) -> str:
    """One line of what a role has done."""
    if isinstance(progress, RelayProgress):
        line = f"{counted(progress.relayed, 'message')} sent back in {counted(progress.runs, 'run')}"
        return f"{line}, {progress.foreign} without our stamp left alone" if progress.foreign else line
    p50, p99 = (format_duration(time_ns, "ms") for time_ns in (progress.rtt_p50_ns, progress.rtt_p99_ns))
    return (
        f"sent {progress.sent}/{progress.planned}, received {progress.received}, lost {progress.lost}, "
        f"RTT p50 {p50}, p99 {p99}"
    )


class TerminalWatch:
    """A `recorder.Watch` on stderr; without a terminal there are the notes alone."""

    def __init__(self) -> None:
        self._console = Console(stderr=True, highlight=False)
        # Drawn by our caller's thread when it calls, by no thread of its own: each drawing holds the
        # interpreter lock for a while, and a received message would wait for it.
        self._live = Live(
            console=self._console,
            auto_refresh=False,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )

    def __enter__(self) -> TerminalWatch:  # noqa: PYI034 - `Self` is Python 3.11's
        """Start drawing, on a terminal."""
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the line away."""
        self._live.stop()

    def note(self, text: str) -> None:
        """Print a line that stays."""
        if self._console.is_terminal:
            self._console.print(Text(text))
        else:
            print(text, file=sys.stderr, flush=True)

    def progress(self, progress: PingProgress | RelayProgress) -> None:
        """Draw the line anew."""
        if self._live.is_started:
            self._live.update(
                Text(describe_progress(progress), no_wrap=True, overflow="ellipsis"), refresh=True
            )

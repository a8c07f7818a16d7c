"""`dds-trace watch FOLDER`: the HTML report on a local address, updated whenever a trace changes."""

import signal
import time
from contextlib import suppress
from pathlib import Path
from types import FrameType, TracebackType
from typing import Annotated

from dds_trace.base import limits

from .program import argument, command, make_app, option

LOOK_SECONDS = 3.0
"""Default time between two checks of the files."""

app = make_app()


@command(app, "watch", table="watch")
def watch_command(
    folder: Annotated[Path, argument("FOLDER", "Folder that a sweep writes into.", exists=True)],
    host: Annotated[
        str,
        option(
            "--host ADDRESS", "Address to listen on; anybody who reaches it can read the report.", show_default=True
        ),
    ] = "127.0.0.1",
    port: Annotated[
        int, option("--port PORT", "Port to listen on; 0 takes a free one.", min=0, max=65535, show_default=True)
    ] = 8765,
    every: Annotated[
        float, option("--every SECONDS", "Time between two checks of the files.", min=0.1, show_default=True)
    ] = LOOK_SECONDS,
    out: Annotated[
        Path | None, option("--out FOLDER", "Folder for all files. Default: analysis/ in the folder of the traces")
    ] = None,
) -> None:
    """Show the report in a browser while a sweep writes; Ctrl-C ends.

    For example:

        dds-trace watch runs/
    """
    from dds_trace.reports.html.live import Watcher, WatchOptions

    limits.check(limits.HOST, host, "--host")
    limits.check(limits.LOOK_S, every, "--every")
    limits.check(limits.FOLDER, None if out is None else str(out), "--out")
    watcher = Watcher(WatchOptions(folder, out), host, port)
    with _CtrlC() as ctrl_c, watcher.serving():
        print(f"Serving {watcher.address}", flush=True)
        while not ctrl_c.pressed:
            watcher.refresh()
            ctrl_c.wait(every)
    print("Stopped")


class _CtrlC:
    """Ctrl-C ends a wait at once, and an analysis after its end or if pressed twice."""

    def __init__(self) -> None:
        self.pressed = False
        self._waiting = False

    def __enter__(self) -> "_CtrlC":  # noqa: PYI034 - `Self` is Python 3.11's
        self._before = signal.signal(signal.SIGINT, self._note)
        return self

    def wait(self, seconds: float) -> None:
        with suppress(KeyboardInterrupt):
            try:
                self._waiting = True
                if not self.pressed:
                    time.sleep(seconds)
            finally:
                self._waiting = False

    def _note(self, number: int, frame: FrameType | None) -> None:
        if self.pressed and not self._waiting:
            signal.default_int_handler(number, frame)
        self.pressed = True
        if self._waiting:
            raise KeyboardInterrupt

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        signal.signal(signal.SIGINT, self._before)

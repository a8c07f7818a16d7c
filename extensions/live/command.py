"""`dds-trace watch FOLDER`: the HTML report on a local address, updated whenever a trace changes."""

from pathlib import Path
from typing import Annotated

from dds_trace.base import limits
from dds_trace.cli.program import argument, command, make_app, option

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
    names: Annotated[
        list[str] | None,
        option("--name HOST", "Another name of this machine for browsers; repeatable. Default: its host name"),
    ] = None,
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
    """Serve a live report while a sweep is running (Ctrl-C to stop).

    For example:

        dds-trace watch runs/
    """
    from dds_trace.recorder.host.process import stop_at_signals

    from .live import Watcher, WatchOptions

    limits.check(limits.HOST, host, "--host")
    limits.check(limits.LOOK_S, every, "--every")
    limits.check(limits.FOLDER, None if out is None else str(out), "--out")
    watcher = Watcher(WatchOptions(folder, out), host, port, names or ())
    stop = stop_at_signals()
    with watcher.serving():
        print(f"Serving {watcher.address}", flush=True)
        while not stop.is_set():
            watcher.refresh()
            stop.wait(every)
    print("Stopped")

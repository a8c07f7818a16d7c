"""`dds-trace studio`: asks for a load between two devices on a local page, and searches, proves and shows the answer there."""

from __future__ import annotations

import secrets
from importlib import import_module
from pathlib import Path
from typing import Annotated

from dds_trace.base import limits
from dds_trace.base.errors import OutputError
from dds_trace.cli.program import command, make_app, option

from ..commands.common import Out, run_until_interrupted

app = make_app()


@command(app, "studio")
def studio_command(
    out: Out = Path("runs"),
    port: Annotated[
        int, option("--port PORT", "Port to listen on; 0 takes a free one.", min=0, max=65535, show_default=True)
    ] = 8766,
) -> None:
    """Find middleware and settings for a load on a local page.

    Open the printed address on this machine; Ctrl-C ends. The page does what `dds-trace advise` does, and nothing else. For example:

        dds-trace studio
    """
    limits.check(limits.FOLDER, str(out), "--out")
    import_module("polars")  # before minutes of recording
    from dds_trace.extensions.live.local_server import LocalServer

    from .desk import Desk

    desk, key = Desk(out), secrets.token_urlsafe()
    try:
        server = LocalServer("127.0.0.1", port, desk.answers, posts=desk.posts, key=key)
    except OSError as err:
        raise OutputError(f"port {port}: cannot serve there ({err.strerror}); choose another --port") from err

    def run() -> int:
        with server.serving():
            print(f"Open http://127.0.0.1:{server.server_address[1]}/?key={key}", flush=True)
            return desk.work()

    run_until_interrupted(run, out, next_step="what was measured is kept")

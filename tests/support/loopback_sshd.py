"""An `sshd` of a test's own on the loopback interface, with keys of its own; nothing of the user's ssh is touched."""

from __future__ import annotations

import getpass
import os
import shutil
import socket
import subprocess
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Iterator

PATH = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"


@dataclass(frozen=True)
class Sshd:
    destination: str
    options: tuple[str, ...]


def missing_program() -> str | None:
    return next((name for name in ("sshd", "ssh", "ssh-keygen") if shutil.which(name, path=PATH) is None), None)


@contextmanager
def sshd(folder: Path) -> Iterator[Sshd]:
    for name in ("host_key", "user_key"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / name], check=True)
    if os.geteuid() == 0:
        Path("/run/sshd").mkdir(exist_ok=True)  # where it locks itself in; the package makes it at boot
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    configuration = folder / "sshd_config"
    configuration.write_text(
        f"ListenAddress 127.0.0.1:{port}\n"
        f"HostKey {folder / 'host_key'}\n"
        f"AuthorizedKeysFile {folder / 'user_key.pub'}\n"
        "PidFile none\nStrictModes no\nUsePAM no\nPasswordAuthentication no\nPermitRootLogin prohibit-password\n"
    )
    # sshd wants to be called by its full path.
    server = subprocess.Popen(
        [shutil.which("sshd", path=PATH), "-D", "-e", "-f", configuration], stderr=subprocess.PIPE
    )
    try:
        wait_until_it_listens(server, port)
        options = (
            *("-p", str(port), "-i", str(folder / "user_key"), "-o", "IdentitiesOnly=yes", "-o", "LogLevel=ERROR"),
            *("-F", "none", "-o", "StrictHostKeyChecking=no", "-o", f"UserKnownHostsFile={folder / 'known'}"),
        )
        yield Sshd(f"{getpass.getuser()}@127.0.0.1", options)
    finally:
        server.terminate()
        server.communicate()


def wait_until_it_listens(server: subprocess.Popen[bytes], port: int) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while True:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        if server.poll() is not None or time.monotonic() > deadline:
            server.kill()
            raise RuntimeError(f"sshd did not come up: {server.communicate()[1].decode()}")
        time.sleep(0.02)

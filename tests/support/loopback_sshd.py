"""An `sshd` of a test's own with keys of its own; nothing of the user's ssh is touched, and it has no port: each `ssh` starts one."""

import getpass
import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

PATH = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"


@dataclass(frozen=True)
class Sshd:
    destination: str
    options: tuple[str, ...]


def sshd(folder: Path, prefix: str = "") -> Sshd:
    """Start it with the words of `prefix` before, such as those that enter a network namespace."""
    for name in ("sshd", "ssh", "ssh-keygen"):
        if shutil.which(name, path=PATH) is None:
            pytest.skip(f"{name} is not installed")
    for name in ("host_key", "user_key"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / name], check=True)
    if os.geteuid() == 0:
        Path("/run/sshd").mkdir(exist_ok=True)  # where it locks itself in; the package makes it at boot
    configuration = folder / "sshd_config"
    configuration.write_text(
        f"HostKey {folder / 'host_key'}\n"
        f"AuthorizedKeysFile {folder / 'user_key.pub'}\n"
        "PidFile none\nStrictModes no\nUsePAM no\nPasswordAuthentication no\nPermitRootLogin prohibit-password\n"
    )
    # sshd wants to be called by its full path.
    server = f"ProxyCommand={prefix} {shutil.which('sshd', path=PATH)} -i -f {configuration} -E {folder / 'log'}"
    options = (
        *("-o", server, "-i", str(folder / "user_key"), "-o", "IdentitiesOnly=yes", "-o", "LogLevel=ERROR"),
        *("-F", "none", "-o", "StrictHostKeyChecking=no", "-o", f"UserKnownHostsFile={folder / 'known'}"),
    )
    return Sshd(f"{getpass.getuser()}@127.0.0.1", options)


def robot(folder: Path, prefix: str = "") -> str:
    """The `[devices.relay]` of a plan whose relay is reached through ssh, with a home of its own in the folder."""
    for name in ("home", "sshd"):
        (folder / name).mkdir()
    server = sshd(folder / "sshd", prefix)
    return (
        f'[devices.relay]\nname = "robot"\nssh = {json.dumps(server.destination)}\nssh_options = {json.dumps(server.options)}\n'
        f'setup = "export HOME={folder / "home"}"\npath = "{Path(sys.executable).parent}"\n'
    )

"""Two network namespaces that pass for two devices, and the commands that a page of the docs gives for each."""

import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from namespaces import needs_namespaces
from processes import RunningCommand

from dds_trace.extensions.campaigns.station.emulation import INTERFACE, ip
from dds_trace.extensions.campaigns.station.namespaces import NamespacePair, Side

SUBNET = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "", "ROS_LOCALHOST_ONLY": "", "ROS_DOMAIN_ID": ""}
"""The tests' own environment keeps to this machine; a namespace of two may look around."""


needs_devices = needs_namespaces("nsenter", "util-linux")


@dataclass(frozen=True)
class Block:
    """A fenced block of commands: below which heading it stands, whose device its first line names."""

    section: str
    device: str
    lines: tuple[str, ...]


def command_blocks(page: Path) -> list[Block]:
    section, found = "", []
    for part in re.finditer(r"^## (?P<heading>.+)$|^```sh\n# (?P<device>\w+)'s device.*\n(?P<body>(?:.*\n)+?)```$",
                            re.sub(r" *\\\n *", " ", page.read_text()), re.MULTILINE):  # fmt: skip
        if part["heading"]:
            section = part["heading"]
        else:
            found.append(Block(section, part["device"], tuple(part["body"].splitlines())))
    return found


class Device:
    """A namespace with a folder of its own and shared memory that all its processes have in common."""

    def __init__(self, side: Side, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()
        self._holder = subprocess.Popen(
            [*side.prefix, "sh", "-c", "echo ready; exec sleep infinity"], stdout=subprocess.PIPE, text=True
        )
        assert self._holder.stdout is not None
        assert self._holder.stdout.readline() == "ready\n"
        self.enter = ["nsenter", "--target", str(self._holder.pid), "--mount", "--net"]

    def start(self, program: str, *arguments: object, **variables: str) -> RunningCommand:
        """One of our commands as it runs on this device, in its folder."""
        inside = [*self.enter, "sh", "-c", 'cd "$0" && exec "$@"', str(self.folder)]
        return RunningCommand(program, *arguments, prefix=inside, environment={**SUBNET, **variables})

    def close(self) -> None:
        self._holder.kill()
        self._holder.communicate()


@contextmanager
def two_devices(folder: Path, ping: str, relay: str) -> Iterator[tuple[NamespacePair, dict[str, Device]]]:
    """Both devices by name, at these addresses, and the link between them; nothing of them is left."""
    with NamespacePair(None) as pair:
        for side, address in ((pair.ping, ping), (pair.relay, relay)):
            ip("-n", side.namespace, "address", "flush", "dev", INTERFACE)
            ip("-n", side.namespace, "address", "add", f"{address}/24", "dev", INTERFACE)
            ip("-n", side.namespace, "route", "replace", "224.0.0.0/4", "dev", INTERFACE)
        devices: dict[str, Device] = {}
        try:
            for name, side in (("ping", pair.ping), ("relay", pair.relay)):
                devices[name] = Device(side, folder / f"{name}_device")
            yield pair, devices
        finally:
            for device in devices.values():
                device.close()

"""The environment's fingerprint: what of this device a reader needs before comparing its numbers with others'.

Nothing here identifies a person or a device: no host name, no address, no serial number, and of a
configuration file its name and hash only. A field that this system does not tell is null or empty; a
missing file under `/proc` or `/sys` is never an error.
"""

from __future__ import annotations

import hashlib
import os
import platform
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_SOCKET_BUFFER_FILES = (
    "rmem_default",
    "rmem_max",
    "wmem_default",
    "wmem_max",
    "optmem_max",
    "netdev_max_backlog",
)

# Variables that change what a middleware does without being a file. Their values go into the trace whole.
_SETTING_VARIABLES = (
    "RMW_IMPLEMENTATION",
    "ROS_DISTRO",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_LOCALHOST_ONLY",
    "FASTDDS_BUILTIN_TRANSPORTS",
    "RMW_FASTRTPS_PUBLICATION_MODE",
    "RMW_FASTRTPS_USE_QOS_FROM_XML",
)

_WIFI_COMMAND_TIMEOUT_S = 2.0


@dataclass(frozen=True, slots=True)
class _ConfigurationVariable:
    """How one middleware is told where its configuration is.

    Attributes:
        name: the environment variable.
        separator: what stands between several entries of its value; None if it holds one only.
    """

    name: str
    separator: str | None = None


_CONFIGURATION_VARIABLES = (
    _ConfigurationVariable("FASTDDS_DEFAULT_PROFILES_FILE"),
    _ConfigurationVariable("FASTRTPS_DEFAULT_PROFILES_FILE"),
    _ConfigurationVariable("CYCLONEDDS_URI", ","),
    _ConfigurationVariable("NDDS_QOS_PROFILES", ";"),
    _ConfigurationVariable("ZENOH_CONFIG"),
    _ConfigurationVariable("ZENOH_SESSION_CONFIG_URI"),
    _ConfigurationVariable("ZENOH_ROUTER_CONFIG_URI"),
    _ConfigurationVariable("ZENOH_CONFIG_OVERRIDE"),
)

# Files that Fast DDS and Connext load from the working directory without being told.
_IMPLICIT_FILES = (
    "DEFAULT_FASTDDS_PROFILES.xml",
    "DEFAULT_FASTRTPS_PROFILES.xml",
    "USER_QOS_PROFILES.xml",
)


def host_fingerprint(versions: Mapping[str, str] | None = None) -> dict[str, Any]:
    """The `host` object of a session.

    Args:
        versions: of the middleware and its client library, by package name, as the backend found them.

    Returns:
        A JSON object with the fields `machine`, `board`, `cpu_model`, `cpu_cores`, `cpu_cores_physical`,
        `cpu_governor`, `cpu_max_mhz`, `os`, `kernel`, `kernel_realtime`, `memory_bytes`, `python`, `versions`,
        `configuration` (variable or file name -> entries of `name`, `sha256`), `settings` (environment
        variables), `socket_buffers` (`net.core.rmem_max` and so on, bytes), `mtu` (interface -> bytes,
        interfaces that are up), `clock_source`, `container` and `wifi` (interface -> see `wifi_links`).
    """
    return {
        "machine": platform.machine(),
        "board": _board(),
        "cpu_model": _cpu_model(),
        "cpu_cores": os.cpu_count(),
        "cpu_cores_physical": psutil.cpu_count(logical=False),
        "cpu_governor": read_text("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"),
        "cpu_max_mhz": _cpu_max_mhz(),
        "os": _os_name(),
        "kernel": platform.release(),
        "kernel_realtime": is_realtime_kernel(),
        "memory_bytes": psutil.virtual_memory().total,
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "versions": dict(versions or {}),
        "configuration": middleware_configuration(os.environ, Path.cwd()),
        "settings": {name: os.environ[name] for name in _SETTING_VARIABLES if name in os.environ},
        "socket_buffers": socket_buffers(),
        "mtu": interface_mtus(),
        "clock_source": read_text("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        "container": container_name(),
        "wifi": wifi_links(),
    }


def read_text(path: str | Path) -> str | None:
    """The file's text without surrounding blanks and NULs, None where there is no such file to read."""
    try:
        return Path(path).read_text(errors="replace").strip("\0 \n")
    except OSError:
        return None


def middleware_configuration(
    environment: Mapping[str, str], folder: Path
) -> dict[str, list[dict[str, str | None]]]:
    """What each configuration source of a middleware holds, as a hash.

    Args:
        environment: the variables to look at.
        folder: the working directory, from which some middlewares load a file without being told.

    Returns:
        Variable (or, for a file found in `folder`, `./NAME`) -> one entry for each file or inline text:
        `name` (the file's base name or `inline`) and `sha256`, null where the file cannot be read.
    """
    found = {
        variable.name: [_hashed(entry) for entry in _entries(environment[variable.name], variable.separator)]
        for variable in _CONFIGURATION_VARIABLES
        if environment.get(variable.name)
    }
    for name in _IMPLICIT_FILES:
        if (folder / name).is_file():
            found[f"./{name}"] = [_hashed(str(folder / name))]
    return found


def _entries(value: str, separator: str | None) -> Iterator[str]:
    # Inline XML or JSON may hold the separator itself; it is hashed whole.
    inline = value.lstrip().startswith(("<", "{", "str://"))
    parts = [value] if inline or separator is None else value.split(separator)
    return (part.strip() for part in parts if part.strip())


def _hashed(entry: str) -> dict[str, str | None]:
    path = Path(entry.removeprefix("file://"))
    try:
        return {"name": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    except OSError:
        if entry.startswith(("<", "{", "str://")) or "=" in entry:
            return {"name": "inline", "sha256": hashlib.sha256(entry.encode()).hexdigest()}
        return {"name": path.name, "sha256": None}


def socket_buffers() -> dict[str, int]:
    """Kernel limits that bound a middleware's socket buffers: `net.core.NAME` -> bytes (or packets).

    In a network namespace other than the first, Linux before 6.10 or so shows only some of them.
    """
    texts = {f"net.core.{name}": read_text(f"/proc/sys/net/core/{name}") for name in _SOCKET_BUFFER_FILES}
    for protocol in ("udp_mem", "tcp_rmem", "tcp_wmem"):
        texts |= {
            f"net.ipv4.{protocol}.{bound}": text
            for bound, text in zip(
                ("min", "default", "max"),
                (read_text(f"/proc/sys/net/ipv4/{protocol}") or "").split(),
                strict=False,
            )
        }
    return {name: int(text) for name, text in texts.items() if text and text.isdigit()}


def interface_mtus() -> dict[str, int]:
    """MTU in bytes of each network interface that is up."""
    try:
        return {name: stats.mtu for name, stats in psutil.net_if_stats().items() if stats.isup}
    except OSError:
        return {}


def wifi_signals() -> dict[str, dict[str, float]]:
    """Interface -> `link_quality`, `signal_dbm`, `noise_dbm` of each wireless interface with a link.

    Read from `/proc/net/wireless`, cheap enough for once a second.
    """
    signals: dict[str, dict[str, float]] = {}
    for line in (read_text("/proc/net/wireless") or "").splitlines()[2:]:
        interface, _, rest = line.partition(":")
        values = rest.split()
        if len(values) >= 4:
            quality, signal, noise = (float(value.rstrip(".")) for value in values[1:4])
            signals[interface.strip()] = {"link_quality": quality, "signal_dbm": signal, "noise_dbm": noise}
    return signals


def wifi_links() -> dict[str, dict[str, float]]:
    """Interface -> its signal (`wifi_signals`) and, where `iw` is installed, `frequency_mhz` and `bitrate_mbit_s`.

    Names of networks and addresses of access points are left out on purpose.
    """
    links = wifi_signals()
    iw = shutil.which("iw", path=os.environ.get("PATH", "") + ":/usr/sbin:/sbin")
    for interface, link in links.items():
        text = _output_of([iw, "dev", interface, "link"]) if iw else ""
        for name, pattern in (
            ("frequency_mhz", r"freq: ([\d.]+)"),
            ("bitrate_mbit_s", r"tx bitrate: ([\d.]+) MBit/s"),
        ):
            found = re.search(pattern, text)
            if found:
                link[name] = float(found[1])
    return links


def _output_of(command: list[str]) -> str:
    try:
        return subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=_WIFI_COMMAND_TIMEOUT_S,
            check=False,
        ).stdout
    except (OSError, subprocess.TimeoutExpired):
        return ""


def is_realtime_kernel() -> bool:
    """Whether the kernel is PREEMPT_RT."""
    return read_text("/sys/kernel/realtime") == "1" or "PREEMPT_RT" in platform.version()


def container_name() -> str | None:
    """Which kind of container this process is in (`docker`, `podman`, `lxc` ...), None on the bare system."""
    for path, name in (("/.dockerenv", "docker"), ("/run/.containerenv", "podman")):
        if Path(path).exists():
            return name
    declared = re.search(r"(?:^|\0)container=([^\0]+)", read_text("/proc/1/environ") or "")
    if declared:
        return declared[1]
    listed = re.search(r"docker|kubepods|lxc|containerd", read_text("/proc/1/cgroup") or "")
    return listed[0] if listed else None


def _board() -> str | None:
    """`Raspberry Pi 4 Model B Rev 1.4` on an Arm board, the product's name on a PC."""
    return read_text("/proc/device-tree/model") or read_text("/sys/class/dmi/id/product_name")


def _cpu_model() -> str:
    # Arm boards have no "model name"; their /proc/cpuinfo also holds the board's serial number, which stays there.
    named = re.search(r"^model name\s*:\s*(.+)$", read_text("/proc/cpuinfo") or "", re.MULTILINE)
    if named:
        return named[1].strip()
    part = re.search(r"^CPU part\s*:\s*(\S+)$", read_text("/proc/cpuinfo") or "", re.MULTILINE)
    return f"{platform.machine()} part {part[1]}" if part else platform.processor() or platform.machine()


def _cpu_max_mhz() -> float | None:
    text = read_text("/sys/devices/system/cpu/cpu0/cpufreq/cpuinfo_max_freq")
    return int(text) / 1000 if text and text.isdigit() else None


def _os_name() -> str:
    try:
        return platform.freedesktop_os_release().get("PRETTY_NAME", platform.system())
    except OSError:
        return platform.system()

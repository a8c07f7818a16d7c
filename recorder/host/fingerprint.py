"""The fingerprint of a device: the facts that a reader needs before comparing its numbers with those of others.

Nothing here identifies a person or a device: no host name, no address, no serial number. A field that this system
does not report is null or empty; a missing file under `/proc` or `/sys` is never an error.
"""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import psutil

from ..applied.counters import read_limits
from .environment import MiddlewareEnvironment

if TYPE_CHECKING:
    from collections.abc import Mapping

    from dds_trace.tracefile.format.json_fields import Json

_SOCKET_BUFFER_FILES = (
    "rmem_default",
    "rmem_max",
    "wmem_default",
    "wmem_max",
    "optmem_max",
    "netdev_max_backlog",
)

_WIFI_COMMAND_TIMEOUT_S = 2.0


def host_fingerprint(
    versions: Mapping[str, str] | None = None, environment: MiddlewareEnvironment | None = None
) -> dict[str, Json]:
    """Return the `host` object of a session.

    Args:
        versions: version of the middleware and its client library, by package name, as the backend reports them.
        environment: variables and files by which the middlewares can be configured.

    Returns:
        A JSON object with the fields `machine`, `board`, `cpu_model`, `cpu_cores`, `cpu_cores_physical`,
        `cpu_governor`, `cpu_max_mhz`, `os`, `kernel`, `kernel_realtime`, `memory_bytes`, `python`, `versions`,
        `configuration` (variable or file name -> entries of `name`, `sha256`), `settings` (environment
        variables), `socket_buffers` (`net.core.rmem_max` and so on, bytes), `reassembly` (see `reassembly_limits`),
        `mtu` (interface -> bytes, interfaces that are up), `clock_source`, `container` and `wifi` (interface -> see `wifi_links`).
    """
    environment = environment or MiddlewareEnvironment()
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
        "configuration": environment.hash_configuration(os.environ, Path.cwd()),
        "settings": environment.read_settings(os.environ),
        "socket_buffers": socket_buffers(),
        "reassembly": reassembly_limits(),
        "mtu": interface_mtus(),
        "clock_source": read_text("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        "container": container_name(),
        "wifi": wifi_links(),
    }


def read_text(path: str | Path) -> str | None:
    """Return a file's text without surrounding blanks and NULs, None where there is no such file to read."""
    try:
        return Path(path).read_text(errors="replace").strip("\0 \n")
    except OSError:
        return None


def socket_buffers() -> dict[str, int]:
    """Return the kernel's limits of socket buffers: `net.core.NAME` -> bytes (or packets).

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


def reassembly_limits() -> dict[str, int]:
    """Return the kernel's limits of putting IP fragments together.

    These are `net.ipv4.ipfrag_time` (seconds that a fragment waits for the others), `net.ipv4.ipfrag_high_thresh` and
    `ipfrag_low_thresh` (bytes of all that wait) and `ipfrag_max_dist` (fragments of others in between).
    """
    return {name: value for name, value in read_limits().items() if name.startswith("net.ipv4.ipfrag_")}


def interface_mtus() -> dict[str, int]:
    """Return the MTU in bytes of each network interface that is up."""
    try:
        return {name: stats.mtu for name, stats in psutil.net_if_stats().items() if stats.isup}
    except OSError:
        return {}


def wifi_signals() -> dict[str, dict[str, float]]:
    """Return the signal of each wireless interface with a link: name -> `link_quality`, `signal_dbm`, `noise_dbm`.

    They are read from `/proc/net/wireless`, cheap enough for once a second.
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
    """Return the links of `wifi_signals` and, where `iw` is installed, their `frequency_mhz` and `bitrate_mbit_s`.

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
            value = re.search(pattern, text)
            if value:
                link[name] = float(value[1])
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
    """Tell whether the kernel is PREEMPT_RT."""
    return read_text("/sys/kernel/realtime") == "1" or "PREEMPT_RT" in platform.version()


def container_name() -> str | None:
    """Return the kind of container of this process (`docker`, `podman`, `lxc` ...), None on the bare system."""
    for path, name in (("/.dockerenv", "docker"), ("/run/.containerenv", "podman")):
        if Path(path).exists():
            return name
    declared = re.search(r"(?:^|\0)container=([^\0]+)", read_text("/proc/1/environ") or "")
    if declared:
        return declared[1]
    listed = re.search(r"docker|kubepods|lxc|containerd", read_text("/proc/1/cgroup") or "")
    return listed[0] if listed else None


def _board() -> str | None:
    """Return the board's model, such as `Raspberry Pi 4 Model B Rev 1.4`; on a PC the product's name."""
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

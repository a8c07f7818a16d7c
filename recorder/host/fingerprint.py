"""The fingerprint of a device, without host name, address or serial number; what the system does not report is null or empty."""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import psutil

from dds_trace.tracefile.format.json_fields import Json

from ..kernel.counters import read_limits
from .environment import MiddlewareEnvironment

_SOCKET_BUFFERS = ("rmem_default", "rmem_max", "wmem_default", "wmem_max", "optmem_max", "netdev_max_backlog")

_IW_TIMEOUT_S = 2.0


def host_fingerprint(
    versions: Mapping[str, str] | None = None, environment: MiddlewareEnvironment | None = None
) -> dict[str, Json]:
    """Return the `host` object of a session (docs/trace-format.md); `versions` lists the middleware and its client library."""
    environment = environment or MiddlewareEnvironment()
    return {
        "machine": platform.machine(),
        "board": read_text("/proc/device-tree/model") or read_text("/sys/class/dmi/id/product_name"),
        "cpu_model": _cpu_model(),
        "cpu_cores": os.cpu_count(),
        "cpu_cores_physical": psutil.cpu_count(logical=False),
        "cpu_governor": read_text("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"),
        "cpu_max_mhz": read_mhz("/sys/devices/system/cpu/cpu0/cpufreq/cpuinfo_max_freq"),
        "os": _os_name(),
        "kernel": platform.release(),
        "kernel_realtime": read_text("/sys/kernel/realtime") == "1" or "PREEMPT_RT" in platform.version(),
        "memory_bytes": psutil.virtual_memory().total,
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "versions": dict(versions or {}),
        "configuration": environment.hash_configuration(os.environ, Path.cwd()),
        "settings": environment.read_settings(os.environ),
        "socket_buffers": _socket_buffers(),
        "reassembly": {name: n for name, n in read_limits().items() if name.startswith("net.ipv4.ipfrag_")},
        "mtu": _interface_mtus(),
        "clock_source": read_text("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        "container": _container_name(),
        "wifi": _wifi_links(),
    }


def read_text(path: str | Path) -> str | None:
    try:
        return Path(path).read_text(errors="replace").strip("\0 \n")
    except OSError:
        return None


def read_mhz(path: str) -> float | None:
    khz = read_text(path)
    return int(khz) / 1000 if khz and khz.isdigit() else None


def read_boot_id() -> str | None:
    """Return what identifies this process's monotonic clock: the boot, in a time namespace with its offset in seconds and ns."""
    boot_id = read_text("/proc/sys/kernel/random/boot_id") or None
    offset = re.search(r"^monotonic\s+(-?\d+)\s+(\d+)", read_text("/proc/self/timens_offsets") or "", re.MULTILINE)
    is_elsewhere = offset is not None and offset.groups() != ("0", "0")
    return f"{boot_id} monotonic {offset[1]} {offset[2]}" if boot_id and offset and is_elsewhere else boot_id


def _socket_buffers() -> dict[str, int]:
    # Linux before about 6.10 shows only some of them in a network namespace.
    texts = {f"net.core.{name}": read_text(f"/proc/sys/net/core/{name}") for name in _SOCKET_BUFFERS}
    for protocol in ("udp_mem", "tcp_rmem", "tcp_wmem"):
        values = (read_text(f"/proc/sys/net/ipv4/{protocol}") or "").split()
        names = (f"net.ipv4.{protocol}.{bound}" for bound in ("min", "default", "max"))
        texts |= dict(zip(names, values, strict=False))
    return {name: int(text) for name, text in texts.items() if text and text.isdigit()}


def _interface_mtus() -> dict[str, int]:
    try:
        return {name: stats.mtu for name, stats in psutil.net_if_stats().items() if stats.isup}
    except OSError:
        return {}


def wifi_signals() -> dict[str, dict[str, float]]:
    signals: dict[str, dict[str, float]] = {}
    for line in (read_text("/proc/net/wireless") or "").splitlines()[2:]:
        interface, _, remainder = line.partition(":")
        values = remainder.split()
        if len(values) >= 4:
            quality, signal, noise = (float(value.rstrip(".")) for value in values[1:4])
            signals[interface.strip()] = {"link_quality": quality, "signal_dbm": signal, "noise_dbm": noise}
    return signals


def _wifi_links() -> dict[str, dict[str, float]]:
    links = wifi_signals()
    iw = shutil.which("iw", path=os.environ.get("PATH", "") + ":/usr/sbin:/sbin")
    for interface, link in links.items():
        text = ""
        with suppress(OSError, subprocess.TimeoutExpired):
            command = [iw or "iw", "dev", interface, "link"]
            text = subprocess.run(command, capture_output=True, text=True, timeout=_IW_TIMEOUT_S, check=False).stdout
        for name, pattern in (("frequency_mhz", r"freq: ([\d.]+)"), ("bitrate_mbit_s", r"tx bitrate: ([\d.]+) MBit/s")):
            value = re.search(pattern, text)
            if value:
                link[name] = float(value[1])
    return links


def _container_name() -> str | None:
    for path, name in (("/.dockerenv", "docker"), ("/run/.containerenv", "podman")):
        if Path(path).exists():
            return name
    declared = re.search(r"(?:^|\0)container=([^\0]+)", read_text("/proc/1/environ") or "")
    if declared:
        return declared[1]
    listed = re.search(r"docker|kubepods|lxc|containerd", read_text("/proc/1/cgroup") or "")
    return listed[0] if listed else None


def _cpu_model() -> str:
    cpuinfo = read_text("/proc/cpuinfo") or ""
    match = re.search(r"^model name\s*:\s*(.+)$", cpuinfo, re.MULTILINE)
    if match:
        return match[1].strip()
    part = re.search(r"^CPU part\s*:\s*(\S+)$", cpuinfo, re.MULTILINE)  # Arm boards have no model name
    return f"{platform.machine()} part {part[1]}" if part else platform.processor() or platform.machine()


def _os_name() -> str:
    try:
        return platform.freedesktop_os_release().get("PRETTY_NAME", platform.system())
    except OSError:
        return platform.system()

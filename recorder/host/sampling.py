"""Samples of the host's load: CPU, memory, network, Wi-Fi signal, and named processes."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import psutil

from dds_trace.base.threads import run_in_background
from dds_trace.tracefile.format.json_fields import Json, JsonObject

from ..kernel.counters import read_kernel_counters
from .clock import read_monotonic_pair
from .fingerprint import read_mhz, read_text, wifi_signals

if TYPE_CHECKING:
    from typing_extensions import Self


_DROP_COUNTERS = ("InErrors", "RcvbufErrors", "SndbufErrors", "ReasmFails", "ReasmTimeout", "FragFails")
"""Dropped datagrams, the usual cause of loss and of late large messages."""


@dataclass(slots=True)
class HostSampler:
    """A context manager: a thread hands a sample (docs/trace-format.md) to `write` each period, and a last one at the end."""

    write: Callable[[JsonObject], None]
    processes: Mapping[str, int] = field(default_factory=dict)
    period_s: float = 1.0
    _stop: threading.Event = field(default_factory=threading.Event, init=False)
    _thread: threading.Thread | None = field(default=None, init=False)
    _followed: dict[int, psutil.Process] = field(default_factory=dict, init=False)
    _sampling_cpu_ns: int = field(default=0, init=False)

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self._run, name="host-sampler", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def _run(self) -> None:
        run_in_background()
        with suppress(OSError):
            self.sample()  # from which the shares of the next one count
        while not self._stop.wait(self.period_s):
            self._write_sample()
        self._write_sample()

    def _write_sample(self) -> None:
        with suppress(OSError):  # the process has no more files for a moment
            self.write(self.sample())

    def sample(self) -> dict[str, Json]:
        began_ns = time.thread_time_ns()
        monotonic_ns, monotonic_raw_ns = read_monotonic_pair()
        loads = {name: self._process_load(pid) for name, pid in {"self": os.getpid(), **self.processes}.items()}
        sample: dict[str, Json] = {
            "monotonic_ns": monotonic_ns,
            "monotonic_raw_ns": monotonic_raw_ns,
            "host": _host_load(),
            "network": _network_totals(),
            "udp": {name: total for name, total in read_kernel_counters().items() if name in _DROP_COUNTERS},
            "wifi": wifi_signals(),
            "processes": {name: load for name, load in loads.items() if load is not None},
            "sampling_cpu_ns": self._sampling_cpu_ns,
        }
        self._sampling_cpu_ns = time.thread_time_ns() - began_ns
        return sample

    def _process_load(self, pid: int) -> dict[str, float] | None:
        try:
            if pid not in self._followed:
                self._followed[pid] = psutil.Process(pid)
            process = self._followed[pid]
            with process.oneshot():
                return {
                    "pid": pid,
                    "cpu_percent": process.cpu_percent(),
                    "memory_bytes": process.memory_info().rss,
                    "threads": process.num_threads(),
                    "involuntary_switches": process.num_ctx_switches().involuntary,
                }
        except psutil.Error:  # it has ended; its supervisor reports that
            self._followed.pop(pid, None)
            return None


def _host_load() -> dict[str, Json]:
    cores = psutil.cpu_percent(percpu=True)
    memory = psutil.virtual_memory()
    millidegrees = read_text("/sys/class/thermal/thermal_zone0/temp") or ""
    return {
        "cpu_percent": round(sum(cores) / max(len(cores), 1), 1),
        "cpu_percent_each": cores,
        "cpu_mhz": read_mhz("/sys/devices/system/cpu/cpu0/cpufreq/scaling_cur_freq"),
        "memory_used_bytes": memory.total - memory.available,
        "memory_available_bytes": memory.available,
        "load_1min": os.getloadavg()[0],
        "temperature_c": int(millidegrees) / 1000 if millidegrees.lstrip("-").isdigit() else None,
        "steal_ns": round(getattr(psutil.cpu_times(), "steal", 0.0) * 1e9),
        "pressure_us": _pressure_us(),
    }


def _pressure_us() -> dict[str, Json]:
    totals: dict[str, Json] = {}
    for resource in ("cpu", "io", "memory"):
        line = (read_text(f"/proc/pressure/{resource}") or "").partition("\n")[0]
        total = line.rpartition("total=")[2]
        if total.isdigit():
            totals[resource] = int(total)
    return totals


def _network_totals() -> dict[str, dict[str, int]]:
    try:
        totals = psutil.net_io_counters(pernic=True)
    except OSError:
        return {}
    return {
        interface: {
            "sent_bytes": total.bytes_sent,
            "received_bytes": total.bytes_recv,
            "sent_packets": total.packets_sent,
            "received_packets": total.packets_recv,
            "dropped": total.dropin + total.dropout,
            "errors": total.errin + total.errout,
        }
        for interface, total in totals.items()
    }

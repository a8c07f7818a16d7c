from __future__ import annotations

import json
import os
import queue
import subprocess
import sys

from dds_trace.recorder.host import sampling
from dds_trace.recorder.host.sampling import HostSampler

# Linux 6: a line of names, then a line of values for each protocol.
SNMP = """\
Ip: Forwarding ReasmFails ReasmTimeout FragFails
Ip: 1 3 2 0
Udp: InDatagrams NoPorts InErrors OutDatagrams RcvbufErrors SndbufErrors
Udp: 100 0 7 90 6 0
"""


def test_samples_of_host_and_own_process_arrive_until_stopped():
    samples = queue.Queue()
    with HostSampler(samples.put, period_s=0.02):
        first, second = (samples.get(timeout=30) for _ in range(2))
    assert second["monotonic_ns"] > first["monotonic_ns"]
    assert second["monotonic_raw_ns"] > first["monotonic_raw_ns"]
    json.dumps(first)
    assert first["processes"]["self"]["pid"] == os.getpid()
    assert first["processes"]["self"]["memory_bytes"] > 0
    assert first["host"]["memory_available_bytes"] > 0
    assert len(first["host"]["cpu_percent_each"]) == os.cpu_count()
    assert "lo" in first["network"]
    assert first["sampling_cpu_ns"] > 0


def test_run_shorter_than_a_period_has_one_sample():
    samples = queue.Queue()
    with HostSampler(samples.put, period_s=3600):
        pass
    assert samples.qsize() == 1


def test_named_process_is_followed_until_it_ends():
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        sampler = HostSampler(lambda _sample: None, processes={"bridge": child.pid})
        assert sampler.sample()["processes"]["bridge"]["pid"] == child.pid
        child.communicate(b"\n")
    assert set(sampler.sample()["processes"]) == {"self"}


def test_dropped_datagrams_are_read_from_the_kernel(monkeypatch):
    monkeypatch.setattr(sampling, "read_text", {"/proc/net/snmp": SNMP}.get)
    assert HostSampler(lambda _sample: None).sample()["udp"] == {
        "ReasmFails": 3,
        "ReasmTimeout": 2,
        "FragFails": 0,
        "InErrors": 7,
        "RcvbufErrors": 6,
        "SndbufErrors": 0,
    }


def test_pressure_and_stolen_time_are_totals_since_boot(monkeypatch):
    pressure = "some avg10=75.08 avg60=81.32 avg300=89.07 total=7022655707\nfull avg10=0.00 total=3\n"
    monkeypatch.setattr(sampling, "read_text", {"/proc/pressure/cpu": pressure, "/proc/pressure/io": "odd"}.get)
    monkeypatch.setattr(sampling.psutil, "cpu_percent", lambda **_options: [0.0])
    monkeypatch.setattr(sampling.psutil, "cpu_times", lambda: type("Times", (), {"steal": 26.82}))
    host = HostSampler(lambda _sample: None).sample()["host"]
    assert (host["pressure_us"], host["steal_ns"]) == ({"cpu": 7_022_655_707}, 26_820_000_000)


def test_no_file_under_proc_or_sys_is_needed(monkeypatch):
    monkeypatch.setattr(sampling, "read_text", lambda _path: None)
    sample = HostSampler(lambda _sample: None).sample()
    assert sample["udp"] == {}
    assert sample["host"]["temperature_c"] is None

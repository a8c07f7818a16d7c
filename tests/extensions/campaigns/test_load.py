import os
import resource
import socket
import time
from pathlib import Path

import psutil
import pytest
from waiting import PATIENCE_S, wait_until

from dds_trace.base.errors import OptionError
from dds_trace.extensions.campaigns.load import loaded
from dds_trace.recorder.host import child as child_module


@pytest.fixture(autouse=True)
def own_lock(monkeypatch, tmp_path):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(child_module, "ending_with_parent", list)


def program_of(fields):
    return fields()["load"]["program"]


def children():
    return {child.pid for child in psutil.Process().children(recursive=True)}


@pytest.mark.parametrize("kind", ["cpu", "memory"])
def test_a_load_uses_processors_and_ends_with_the_block(kind):
    before = children()
    with loaded(kind) as fields:
        wait_until(lambda: fields()["load"]["cpu_s"] > 0.1)
        described = fields()["load"]
        assert described["kind"] == kind
        assert described["program"] in ("own", "stress-ng")
        assert described["is_running"]
    assert children() == before


def test_of_two_loads_of_a_machine_one_waits():
    with loaded("cpu") as first:
        wait_until(lambda: program_of(first))
        with loaded("memory") as second:
            time.sleep(0.2)
            assert program_of(second) == ""
            assert second()["load"]["cpu_s"] == 0
            assert second()["load"]["waited_s"] >= 0.2
            assert first()["load"]["waited_s"] < first()["load"]["elapsed_s"]


def test_a_network_load_sends_to_the_other_side():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as discard:
        try:
            discard.bind(("127.0.0.1", 9))
        except OSError:
            pytest.skip("port 9 cannot be opened here")
        discard.settimeout(PATIENCE_S)
        with loaded("network", "127.0.0.1"):
            assert len(discard.recv(2000)) == 1400


def test_a_network_without_an_address_is_not_loaded():
    before = children()
    with loaded("network") as fields:
        assert children() == before
        assert fields is None


def test_a_load_keeps_neither_priority_nor_processors_of_the_recorder():
    before, others = os.sched_getaffinity(0), children()
    os.sched_setaffinity(0, {min(before)})
    try:
        with loaded("cpu") as fields:
            wait_until(lambda: program_of(fields))
            pids = children() - others  # stress-ng has several
            assert pids
            assert all(os.sched_getaffinity(pid) >= before for pid in pids)
    finally:
        os.sched_setaffinity(0, before)


def test_processors_are_kept_awake_at_the_lowest_priority():
    before = children()
    with loaded("awake") as fields:
        wait_until(lambda: fields()["load"]["cpu_s"] > 0.02)
        assert fields()["load"]["program"] == "own"
        (child,) = children() - before
        tasks = Path(f"/proc/{child}/task")
        wait_until(lambda: len(list(tasks.iterdir())) > os.cpu_count())
        policies = {os.sched_getscheduler(int(thread.name)) for thread in tasks.iterdir()}
        assert policies == {os.SCHED_IDLE}
    assert children() == before


@pytest.mark.skipif(os.geteuid() != 0 or len(os.sched_getaffinity(0)) < 2, reason="needs root and two processors")
def test_four_fifths_of_the_relays_processor_are_taken_from_the_first_echo_on():
    before, free = children(), os.sched_getaffinity(0)
    try:
        with loaded("emulated-pi3") as of_ping:
            assert os.sched_getaffinity(0) == free - {max(free)}
            assert of_ping is None
        os.sched_setaffinity(0, free)
        with loaded("emulated-pi3", is_relay=True) as load:
            assert os.sched_getaffinity(0) == {max(free)}
            (child,) = children() - before
            load.begin()
            wait_until(lambda: load()["load"]["cpu_s"] > 0.3)
            assert os.sched_getscheduler(child) == os.SCHED_FIFO
            assert resource.prlimit(child, resource.RLIMIT_RTTIME) == (100_000, 200_000)
            assert os.sched_getaffinity(child) == {max(free)}
            # On the relay's processor this process would be kept from reading both numbers at once.
            os.sched_setaffinity(0, free - {max(free)})

            def is_taken() -> bool:
                first = load()["load"]
                wait_until(lambda: load()["load"]["cpu_s"] > first["cpu_s"] + 0.5)
                second = load()["load"]
                return 0.6 < (second["cpu_s"] - first["cpu_s"]) / (second["elapsed_s"] - first["elapsed_s"]) < 0.9

            wait_until(is_taken)  # another real-time program or the host may keep it waiting for a while
        os.sched_setaffinity(0, {max(free)})
        with pytest.raises(OptionError, match="two processors"), loaded("emulated-pi3", is_relay=True):
            pass
    finally:
        os.sched_setaffinity(0, free)
    assert children() == before


def test_the_latency_of_waking_up_is_read_back_or_refused():
    if not os.access("/dev/cpu_dma_latency", os.R_OK | os.W_OK):
        with pytest.raises(OptionError), loaded("dma-latency"):
            pass
        return
    with loaded("dma-latency") as fields:
        wait_until(lambda: program_of(fields))
        assert program_of(fields) == "cpu_dma_latency 0 us"

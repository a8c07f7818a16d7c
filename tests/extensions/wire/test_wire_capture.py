"""A real capture on the loopback interface, of packets drawn by hand; root only."""

import os
import shutil
import signal
import socket
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest
from processes import executed
from waiting import PATIENCE_S
from wire_packets import SPDP_WRITER, data, data_frag, rtps, stamped

from dds_trace.base.errors import OptionError
from dds_trace.extensions.wire import capture as capture_module
from dds_trace.extensions.wire.capture import WireCapture, WireOptions, domain_ports, run_interfaces
from dds_trace.extensions.wire.format import Direction
from dds_trace.extensions.wire.packet_filter import PortRange, wire_program
from dds_trace.extensions.wire.ring import NO_CAPTURE, PacketRing
from dds_trace.recorder.choices import Discovery

needs_root = pytest.mark.skipif(os.geteuid() != 0, reason="a capture needs CAP_NET_RAW")
RUN = 0xFEED


@pytest.fixture
def own(domains):
    """A socket that nobody else knows, in a domain of the test's own, and what captures it."""
    ports = domain_ports(domains.take())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bound:
        bound.bind(("127.0.0.1", ports.first + 200))
        bound.connect(("127.0.0.1", ports.first + 200))
        yield bound, WireOptions(("lo",), rtps_ports=(ports,))


@needs_root
def test_each_packet_of_the_loopback_interface_counts_once(own):
    out, options = own
    with WireCapture(options) as capture:
        capture.begin(RUN)
        before_ns = time.monotonic_ns()
        out.send(rtps(data(1, b"", writer=SPDP_WRITER)))
        packets = [rtps(data(number + 1, stamped(RUN, number))) for number in range(5)]
        for packet in (*packets, packets[3]):
            out.send(packet)
        out.send(rtps(data_frag(6, 1, stamped(RUN, 5, more=bytes(30000)), 60000)))
        after_ns = time.monotonic_ns()
        found = capture.take()
    counts = found.counts
    assert counts.complete
    assert {one.name: one.packets for one in counts.classes} == {"spdp": 1, "data": 5, "data_again": 1, "data_frag": 1}
    assert {one.direction for one in counts.classes} == {"local"}
    assert counts.total_bytes == 7 * (14 + 20 + 8) + len(rtps()) * 8 + 42 + sum(
        len(packet) - len(rtps())
        for packet in (
            rtps(data(1, b"", writer=SPDP_WRITER)),
            *packets,
            packets[3],
            rtps(data_frag(6, 1, stamped(RUN, 5, more=bytes(30000)), 60000)),
        )
    )
    assert found.rows["sequence"].tolist() == [0, 1, 2, 3, 4, 5]
    assert found.rows["repeats"].tolist() == [0, 0, 0, 1, 0, 0]
    assert set(found.rows["direction"].tolist()) == {Direction.LOCAL}
    assert counts.run_id == f"{RUN:016x}"
    # Stamped by the kernel between two of our own readings; a tenth of a millisecond for the turn of the clocks.
    assert before_ns - 100_000 <= found.rows["first_ns"].min()
    assert found.rows["last_ns"].max() <= after_ns + 100_000


@needs_root
def test_each_run_is_counted_by_itself(own):
    out, options = own
    with WireCapture(options) as capture:
        capture.begin(1)
        out.send(rtps(data(1, stamped(1, 0))))
        first = capture.take()
        out.send(rtps(data(2, stamped(1, 1))))
        capture.begin(2)
        out.send(rtps(data(3, stamped(2, 0))))
        second = capture.take()
    assert first.rows[["run_id", "sequence"]].tolist() == [(1, 0)]
    assert second.rows[["run_id", "sequence"]].tolist() == [(2, 0)]
    assert [one.packets for one in second.counts.classes] == [1]
    assert first.counts.end_ns <= second.counts.begin_ns
    assert second.counts.first_data_ns == first.rows["first_ns"][0]


@needs_root
def test_packets_that_the_kernel_dropped_make_it_inconclusive(own):
    out, options = own
    small = WireOptions(("lo",), rtps_ports=options.rtps_ports, ring_bytes=1 << 19)
    with WireCapture(small) as capture:
        capture.begin(RUN)
        os.kill(capture.pid, signal.SIGSTOP)
        packet = rtps(data(1, bytes(200)))
        for _ in range(6000):
            out.send(packet)
        os.kill(capture.pid, signal.SIGCONT)
        counts = capture.take().counts
    assert counts.kernel_drops > 0
    assert not counts.complete
    assert counts.packets + counts.kernel_drops >= 6000


@needs_root
def test_payload_is_not_in_the_ring(own):
    out, options = own
    secret = b"nobody but the reader may see this"
    del options
    port = out.getsockname()[1]
    with closing(PacketRing("lo", wire_program([], []), ring_bytes=0, block_timeout_ms=20)) as ring:
        out.send(rtps(data(1, bytes(500) + secret * 50)))
        deadline = time.monotonic() + PATIENCE_S
        seen = b""
        while port.to_bytes(2, "big") not in seen and time.monotonic() < deadline:
            batch = ring.read()
            seen += b"".join(
                batch.memory[at : at + size].tobytes()
                for at, size in zip(batch.position.tolist(), batch.captured_bytes.tolist(), strict=True)
            )
            ring.release()
    assert port.to_bytes(2, "big") in seen
    assert secret not in seen


def test_an_interface_that_is_not_there():
    with pytest.raises(OptionError, match="no network interface 'nowhere0'"):
        WireCapture(WireOptions(("nowhere0",)))


@pytest.mark.skipif(not Path("/proc/sys/net").exists(), reason="Linux only")
@needs_root
@pytest.mark.skipif(shutil.which("setpriv") is None, reason="setpriv (util-linux) is not installed")
def test_without_the_capability_there_is_one_clear_line():
    script = "from dds_trace.extensions.wire.capture import WireCapture, WireOptions\nWireCapture(WireOptions(('lo',)))"
    done = executed(["setpriv", "--bounding-set", "-net_raw", sys.executable, "-c", script])
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].endswith(NO_CAPTURE)


@needs_root
def test_the_process_ends_with_its_owner(own):
    _, options = own
    capture = WireCapture(options)
    assert Path(f"/proc/{capture.pid}").exists()
    capture.close()
    assert not Path(f"/proc/{capture.pid}").exists()


@needs_root
def test_a_capture_that_was_killed_says_so(own):
    _, options = own
    with WireCapture(options) as capture:
        os.kill(capture.pid, signal.SIGKILL)
        with pytest.raises(OptionError, match="ended by itself"):
            capture.begin(1)


def test_localhost_discovery_keeps_to_loopback():
    assert run_interfaces(Discovery.LOCALHOST) == ("lo",)
    assert domain_ports(0) == PortRange(7400, 7649)
    assert WireOptions(()).ring_bytes >= 2 * 12_500_000, "two seconds of 100 Mbit/s"


def test_subnet_discovery_uses_all_that_are_up_and_no_port_of_a_bridge(tmp_path, monkeypatch):
    names = [name for _, name in socket.if_nameindex()]
    monkeypatch.setattr(socket, "if_nameindex", lambda: [(1, "lo"), (2, "nowhere0")])
    assert "lo" in names
    assert run_interfaces(Discovery.SUBNET, tmp_path) == ("lo",)
    (tmp_path / "lo" / "master").mkdir(parents=True)
    assert run_interfaces(Discovery.SUBNET, tmp_path) == ()
    monkeypatch.setattr(capture_module, "ask_interface", lambda *_: 0x1002)  # all but up
    assert run_interfaces(Discovery.SUBNET, tmp_path / "none") == ()

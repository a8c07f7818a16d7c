import socket
import struct

import pytest

from dds_trace.recorder.kernel.counters import (
    InterfaceCounters,
    MulticastGroup,
    read_groups,
    read_interfaces,
    read_kernel_counters,
    read_limits,
    since,
)

DEV = """\
Inter-|   Receive                                                |  Transmit
 face |bytes    packets errs drop fifo frame compressed multicast|bytes    packets errs drop fifo colls carrier compressed
    lo:    3193      29    0    0    0     0          0         0     3193      29    0    0    0     0       0          0
  eth0: 768850628   37881    0    0    0     0          0         0  1381082   12953    0    0    0     0       0          0
"""
SNMP = """\
Ip: Forwarding DefaultTTL ReasmTimeout ReasmReqds ReasmOKs ReasmFails FragOKs FragFails FragCreates
Ip: 1 64 3 1000 20 4 7 5 45
Tcp: RtoAlgorithm InErrs
Tcp: 1 99
Udp: InDatagrams NoPorts InErrors OutDatagrams RcvbufErrors SndbufErrors InCsumErrors IgnoredMulti MemErrors
Udp: 17 0 11 21 12 13 14 0 15
UdpLite: InDatagrams NoPorts InErrors OutDatagrams RcvbufErrors SndbufErrors InCsumErrors IgnoredMulti MemErrors
UdpLite: 1 1 77 1 77 77 77 77 77
"""
IGMP = """\
Idx\tDevice    : Count Querier\tGroup    Users Timer\tReporter
1\tlo        :     2      V3
\t\t\t\t{spdp:08X}     1 0:00000000\t\t0
\t\t\t\t{hosts:08X}     1 0:00000000\t\t0
2\teth0      :     1      V3
\t\t\t\t{hosts:08X}     1 0:00000000\t\t0
"""
IGMP6 = """\
1    lo              ff020000000000000000000000000001     1 0000000C 0
2    eth0            ff1e00000000000000000000efff0001     1 00000004 0
2    eth0            ff010000000000000000000000000001     1 00000008 0
"""


def as_kernel_prints(address):
    return struct.unpack("=I", socket.inet_aton(address))[0]


@pytest.fixture
def root(tmp_path):
    igmp = IGMP.format(spdp=as_kernel_prints("239.255.0.1"), hosts=as_kernel_prints("224.0.0.1"))
    texts = {"dev": DEV, "snmp": SNMP, "igmp": igmp, "igmp6": IGMP6}
    (tmp_path / "self/net").mkdir(parents=True)
    for name, text in texts.items():
        (tmp_path / "self/net" / name).write_text(text)
    settings = {
        "core/rmem_max": 212992,
        "ipv4/ipfrag_time": 30,
        "ipv4/ipfrag_high_thresh": 4194304,
        "ipv4/ip_local_port_range": "32768\t60999",
    }
    for name, value in settings.items():
        path = tmp_path / "sys/net" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{value}\n")
    return tmp_path


def test_interfaces_have_bytes_and_packets_both_ways(root):
    assert read_interfaces(root) == {
        "lo": InterfaceCounters(3193, 3193, 29, 29),
        "eth0": InterfaceCounters(1381082, 768850628, 12953, 37881),
    }


def test_what_was_added_since_the_beginning():
    assert since(InterfaceCounters(10, 20, 3, 4), InterfaceCounters(1, 5, 1, 4)) == InterfaceCounters(9, 15, 2, 0)
    assert since(InterfaceCounters(1, 1, 1, 1), None) == InterfaceCounters(1, 1, 1, 1)


def test_lost_fragments_and_datagrams_come_from_the_lines_of_ip_and_udp(root):
    assert read_kernel_counters(root) == {
        "ReasmTimeout": 3,
        "ReasmReqds": 1000,
        "ReasmOKs": 20,
        "ReasmFails": 4,
        "FragOKs": 7,
        "FragFails": 5,
        "FragCreates": 45,
        "InErrors": 11,
        "RcvbufErrors": 12,
        "SndbufErrors": 13,
        "InCsumErrors": 14,
        "MemErrors": 15,
    }


def test_limits_that_this_kernel_has(root):
    assert read_limits(root) == {
        "net.core.rmem_max": 212992,
        "net.ipv4.ipfrag_time": 30,
        "net.ipv4.ipfrag_high_thresh": 4194304,
        "net.ipv4.ip_local_port_range.min": 32768,
    }


def test_groups_by_interface_without_those_of_every_host(root):
    assert read_groups(root) == (MulticastGroup("eth0", "ff1e::efff:1"), MulticastGroup("lo", "239.255.0.1"))


def test_without_proc_nothing_is_known(tmp_path):
    assert read_interfaces(tmp_path) == read_kernel_counters(tmp_path) == read_limits(tmp_path) == {}
    assert read_groups(tmp_path) == ()


def test_a_group_that_this_process_joins_is_seen():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        membership = socket.inet_aton("239.255.77.1") + socket.inet_aton("127.0.0.1")
        opened.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        assert MulticastGroup("lo", "239.255.77.1") in read_groups()

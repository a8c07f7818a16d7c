"""Differences between asked and applied, on read-backs drawn by hand; what honest runs look like raises none."""

from __future__ import annotations

from dataclasses import replace

import pytest
from snapshots import applied, counted, port, segment, tcp, udp

from dds_trace.recorder.applied.asked import Asked
from dds_trace.recorder.applied.carried import Traffic
from dds_trace.recorder.applied.differences import Setting, differences
from dds_trace.recorder.applied.vendors import VENDORS

MB = 1_000_000
TRAFFIC = Traffic(sent=100, received=100, payload_bytes=100_000)
SHARED = (segment(), port(), segment("fastrtps_00000000000000bb", is_own=False), port(7413, is_own=False))
LIMITS = {"net.core.rmem_max": 4_194_304, "net.core.wmem_max": 4_194_304}
TUNED = Asked("fastdds", transport="udp", tuned=True, receive_buffer_bytes=4_000_000, send_buffer_bytes=4_000_000)


def only(asked, read_back, traffic=None):
    (found,) = differences(asked, read_back, traffic)
    return found


def test_udp_that_is_shared_memory_is_named_before_and_after():
    asked = Asked("fastdds", transport="udp")
    sockets = (udp(7410), udp(7411))
    found = only(asked, applied(sockets=sockets, memory=SHARED))
    assert found.setting is Setting.TRANSPORT
    assert found.words == "asked for UDP, shared memory is open (4 files, 2 segments of 1,098,816 bytes)"
    ended = applied(sockets=sockets, memory=SHARED, begin=counted(lo=(0, 0)), end=counted(lo=(MB, MB)))
    found = only(asked, ended, TRAFFIC)
    assert found.words == "asked for UDP, the bytes went through shared memory"
    assert (found.asked, found.applied) == ("udp", "the bytes went through shared memory")


def test_memory_of_another_middleware_or_of_an_ended_participant_is_no_difference():
    zenoh = segment("1.zenoh", vendor="zenoh", is_own=None)
    gone = replace(segment(), is_deleted=True)
    assert differences(Asked("fastdds", transport="udp"), applied(sockets=(udp(7411),), memory=(zenoh, gone))) == ()


def test_shared_memory_that_is_not_there():
    found = only(Asked("fastdds", transport="shm"), applied(sockets=(udp(7411),)))
    assert (found.setting, found.words) == (Setting.TRANSPORT, "asked for shared memory, no shared memory is mapped")


def test_large_data_without_tcp():
    asked = Asked("fastdds", transport="large-data")
    found = only(asked, applied(sockets=(udp(7411),), memory=SHARED))
    assert (found.setting, found.words) == (Setting.LARGE_DATA, "asked for LARGE_DATA, no TCP socket is open")
    assert differences(asked, applied(sockets=(udp(7411), tcp()), memory=SHARED)) == ()


def test_a_profile_whose_transports_come_beside_others():
    asked = Asked("fastdds", transport="udp", profile="mine.xml")
    found = only(asked, applied(sockets=(udp(7411),), memory=SHARED))
    assert found.setting is Setting.PROFILE
    assert found.words.startswith("the profile mine.xml asks for UDP, shared memory is open (4 files")
    assert "useBuiltinTransports" in found.words


def test_buffers_that_stayed_the_systems():
    found = differences(TUNED, applied(sockets=(udp(7411),), limits=LIMITS))
    assert [each.setting for each in found] == [Setting.TUNED, Setting.TUNED]
    assert found[0].words == (
        "asked for receive buffers of 4,000,000 bytes, which the kernel shows as 8,000,000, and it shows 212,992"
    )
    assert found[1].words.startswith("asked for send buffers of 4,000,000 bytes")


def test_buffers_that_the_kernel_cut():
    limits = {"net.core.rmem_max": 212_992, "net.core.wmem_max": 212_992}
    found = differences(TUNED, applied(sockets=(udp(7411, 425_984, 425_984),), limits=limits))
    assert [each.setting for each in found] == [Setting.KERNEL_LIMIT, Setting.KERNEL_LIMIT]
    assert found[0].words.endswith("and it shows 425,984: net.core.rmem_max is 212,992")
    assert (found[0].asked, found[0].applied) == ("4000000", "212992")


def test_one_receiving_socket_with_a_small_buffer_is_enough():
    sending = udp(45_000, send_buffer_bytes=8_000_000)
    large, small = udp(7410, 8_000_000), udp(7411)
    assert [each.setting for each in differences(TUNED, applied(sockets=(sending, large, small), limits=LIMITS))] == [
        Setting.TUNED
    ]
    assert differences(TUNED, applied(sockets=(sending, large), limits=LIMITS)) == ()


def test_the_ports_are_those_of_the_domain():
    asked = replace(TUNED, domain_id=12)
    sockets = (udp(10_411, 8_000_000), udp(7000), udp(45_000, send_buffer_bytes=8_000_000))
    assert differences(asked, applied(sockets=sockets)) == ()
    assert [each.setting for each in differences(replace(asked, domain_id=200), applied(sockets=sockets))] == []


def test_a_sending_socket_whose_port_the_kernel_chose_is_not_a_receiving_one():
    # Domain 115 has the ports from 36150 on, which the kernel gives to anybody.
    asked = replace(TUNED, domain_id=115)
    sockets = (udp(36_160, 8_000_000), udp(36_342, send_buffer_bytes=8_000_000))
    assert differences(asked, applied(sockets=sockets)) == ()
    far = {"net.ipv4.ip_local_port_range.min": 40_000}
    assert [each.setting for each in differences(asked, applied(sockets=sockets, limits=far))] == [Setting.TUNED]


def test_an_interface_that_carried_nothing():
    asked = Asked("cyclonedds", interface="eth1")
    carried = applied(begin=counted(lo=(0, 0), eth1=(0, 0)), end=counted(lo=(20 * MB, 20 * MB), eth1=(900, 900)))
    found = only(asked, carried, TRAFFIC)
    assert (found.setting, found.asked, found.applied) == (Setting.INTERFACE, "eth1", "lo")
    assert found.words == "asked for the interface eth1, the bytes went through lo"
    assert differences(replace(asked, interface="lo"), carried, TRAFFIC) == ()
    assert differences(asked, carried) == ()  # before the end it could still come
    busy = applied(begin=counted(lo=(0, 0), eth1=(0, 0)), end=counted(lo=(900 * MB, 900 * MB), eth1=(0, 0)))
    assert only(asked, busy, TRAFFIC).words == "asked for the interface eth1, the bytes went another way"
    shared = applied(memory=SHARED, begin=counted(lo=(0, 0), eth1=(0, 0)), end=counted(lo=(MB, MB), eth1=(0, 0)))
    assert (
        only(replace(asked, vendor="fastdds"), shared, TRAFFIC).words
        == "asked for the interface eth1, the bytes went through shared memory"
    )


def test_shared_memory_on_and_off():
    memory = (segment("1.zenoh", vendor="zenoh", is_own=None),)
    off, on = Asked("zenoh", shared_memory=False), Asked("zenoh", shared_memory=True)
    assert only(off, applied(memory=memory)).setting is Setting.SHARED_MEMORY
    assert only(on, applied()).words == "asked for shared memory, none is mapped"
    assert differences(on, applied(memory=memory)) == ()
    assert differences(off, applied()) == ()
    ended = applied(memory=memory, begin=counted(lo=(0, 0)), end=counted(lo=(MB, MB)))
    assert only(off, ended, TRAFFIC).words == "asked for no shared memory, the bytes went through it"


def test_shared_memory_that_the_other_side_does_not_see():
    ended = applied(
        memory=(segment("1.zenoh", vendor="zenoh", is_own=None),),
        begin_sockets=(tcp(),),
        sockets=(tcp(10 * MB, 10 * MB),),
        begin=counted(lo=(0, 0)),
        end=counted(lo=(20 * MB, 20 * MB)),
    )
    found = only(Asked("zenoh", shared_memory=True), ended, TRAFFIC)
    assert found.setting is Setting.MEMORY_NAMESPACE
    assert found.words.startswith("asked for shared memory, the bytes went through lo: ")


def test_a_port_that_nobody_serves_while_nothing_comes_back():
    memory = (segment(), port(), port(7413, is_own=False, is_served=False))
    asked, waiting = Asked("fastdds"), applied(sockets=(udp(7411),), memory=memory)
    found = only(asked, waiting, Traffic(20, 0, 100_000))
    assert found.setting is Setting.MEMORY_NAMESPACE
    assert "fastrtps_port7413" in found.words
    assert differences(asked, waiting) == ()
    assert differences(asked, waiting, Traffic(20, 1, 100_000)) == ()


def test_a_port_that_nobody_serves_has_other_reasons():
    in_vain = Traffic(20, 0, 100_000)
    unserved = port(7413, is_own=False, is_served=False)
    foreign = segment("fastrtps_00000000000000bb", is_own=False)

    def settings(*memory, domain_id=0):
        return [each.setting for each in differences(Asked("fastdds", domain_id), applied(memory=memory), in_vain)]

    assert settings(unserved) == [Setting.MEMORY_NAMESPACE]
    # Another domain's participant has sent to a port that all domains share.
    assert settings(unserved, replace(foreign, is_served=True)) == [Setting.MEMORY_NAMESPACE]
    # The receiver was here, and has died.
    assert settings(unserved, replace(foreign, is_served=False, is_abandoned=True)) == []
    assert settings(replace(unserved, is_abandoned=True)) == []
    # Another domain's port, or one that all domains share.
    assert settings(unserved, domain_id=1) == []
    assert settings(port(7001, is_own=False, is_served=False)) == []
    assert settings(port(7413, is_own=False, is_served=None)) == []


def test_a_mapped_file_that_is_not_the_one_here():
    found = only(Asked("fastdds"), applied(memory=(replace(segment(), is_here=False),)))
    assert found.setting is Setting.MEMORY_NAMESPACE
    assert "fastrtps_00000000000000aa is mapped" in found.words


READ_BACKS = [
    applied(),
    applied(sockets=None),
    applied(sockets=(udp(7411), tcp()), memory=SHARED),
    applied(sockets=(tcp(),)),
]


@pytest.mark.parametrize("vendor", [*sorted(set(VENDORS) - {"socket"}), "someone"])
@pytest.mark.parametrize("read_back", READ_BACKS)
def test_a_default_asks_for_nothing(vendor, read_back):
    assert differences(Asked(vendor), read_back) == ()


def test_the_default_of_sockets_is_tcp():
    assert differences(Asked("socket"), applied(sockets=(tcp(),))) == ()
    assert only(Asked("socket"), applied(sockets=(udp(8908),))).words == "asked for TCP, no TCP socket is open"


def test_a_difference_as_the_session_has_it():
    assert only(Asked("fastdds", transport="shm"), applied()).to_json() == {
        "setting": "transport",
        "asked": "shm",
        "applied": "no shared memory is mapped",
        "words": "asked for shared memory, no shared memory is mapped",
    }


def test_where_memory_is_unknown_nothing_is_said_of_it():
    for asked in (Asked("fastdds", transport="shm"), Asked("zenoh", shared_memory=True)):
        assert differences(asked, applied(memory=None)) == ()


def test_where_sockets_are_unknown_nothing_is_said_of_them():
    unknown = applied(sockets=None)
    assert differences(TUNED, unknown) == ()
    assert differences(Asked("fastdds", transport="large-data"), unknown) == ()


def test_an_honest_tuned_run():
    sockets = (
        udp(7410, 8_000_000),
        udp(7411, 8_000_000),
        udp(7000, 8_000_000),
        udp(45_000, send_buffer_bytes=8_000_000),
    )
    ended = applied(sockets=sockets, limits=LIMITS, begin=counted(lo=(0, 0)), end=counted(lo=(20 * MB, 20 * MB)))
    assert differences(TUNED, ended, TRAFFIC) == ()

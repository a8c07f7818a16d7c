"""Differences between asked and applied, on read-backs drawn by hand; what honest runs look like raises none."""

import json
from dataclasses import replace

import pytest
from snapshots import applied, counted, port, segment, tcp, udp

from dds_trace.base.records import from_json, to_json
from dds_trace.recorder.applied.applied import Applied, Snapshot, Traffic, read_applied
from dds_trace.recorder.applied.asked import Asked
from dds_trace.recorder.applied.differences import Setting, differences
from dds_trace.recorder.applied.vendors import VENDORS

MB = 1_000_000
TRAFFIC = Traffic(sent=100, received=100, payload_bytes=100_000)
SHARED = (segment(), port(), segment("fastrtps_00000000000000bb", is_own=False), port(7413, is_own=False))
LIMITS = {"net.core.rmem_max": 4_194_304, "net.core.wmem_max": 4_194_304}
TUNED = Asked("fastdds", transport="udp", tuned=True, receive_buffer_bytes=4_000_000, send_buffer_bytes=4_000_000)


LIMITS_CUT = dict.fromkeys(LIMITS, 212_992)
LOOPBACK = {"begin": counted(lo=(0, 0)), "end": counted(lo=(MB, MB))}
SENDING, LARGE = udp(45_000, send_buffer_bytes=8_000_000), udp(7410, 8_000_000)
ZENOH = (segment("1.zenoh", vendor="zenoh", is_own=None),)
MEMORY_OFF, MEMORY_ON = Asked("zenoh", shared_memory=False), Asked("zenoh", shared_memory=True)
TCP_ONLY = applied(
    memory=ZENOH,
    begin_sockets=(tcp(),),
    sockets=(tcp(10 * MB, 10 * MB),),
    begin=counted(lo=(0, 0)),
    end=counted(lo=(20 * MB, 20 * MB)),
)
UNSERVED = applied(sockets=(udp(7411),), memory=(segment(), port(), port(7413, is_own=False, is_served=False)))
UDP, PROFILE = Asked("fastdds", transport="udp"), Asked("fastdds", transport="udp", profile="mine.xml")
SHM, LARGE_DATA = Asked("fastdds", transport="shm"), Asked("fastdds", transport="large-data")
ETH1 = Asked("cyclonedds", interface="eth1")
SIZED = Asked("zenoh", receive_buffer_bytes=50 * MB, send_buffer_bytes=50 * MB, buffer_is_exact=True)
GRANTED = (replace(tcp(), receive_buffer_bytes=8_388_608, send_buffer_bytes=8_388_608), udp(7446))
BBR = Asked("socket", domain_id=14, congestion_control="bbr")
# Domain 115 has the ports from 36150 on, which the kernel gives to anybody.
IN_115, SOCKETS_OF_115 = replace(TUNED, domain_id=115), (udp(36_160, 8_000_000), replace(SENDING, local_port=36_342))
FAR = {"net.ipv4.ip_local_port_range.min": 40_000}


def carried(lo, eth1, **more):
    return applied(begin=counted(lo=(0, 0), eth1=(0, 0)), end=counted(lo=(lo, lo), eth1=(eth1, eth1)), **more)


@pytest.mark.parametrize(
    ("asked", "read_back", "traffic", "settings"),
    [
        pytest.param(UDP, applied(sockets=(udp(7411),), memory=SHARED), None, "transport", id="udp is memory"),
        pytest.param(UDP, applied(memory=SHARED, **LOOPBACK), TRAFFIC, "transport", id="udp was memory"),
        pytest.param(UDP, carried(20 * MB, 0, memory=SHARED), TRAFFIC, "transport", id="memory is open beside udp"),
        pytest.param(BBR, applied(sockets=(tcp(),)), None, "congestion_control", id="another congestion control"),
        pytest.param(SHM, applied(sockets=(udp(7411),)), None, "transport", id="no memory"),
        pytest.param(Asked("socket"), applied(sockets=(udp(8908),)), None, "transport", id="default of sockets is tcp"),
        pytest.param(LARGE_DATA, applied(sockets=(udp(7411),), memory=SHARED), None, "large_data", id="no tcp"),
        pytest.param(PROFILE, applied(sockets=(udp(7411),), memory=SHARED), None, "profile", id="profile"),
        pytest.param(TUNED, applied(sockets=(udp(7411),), limits=LIMITS), None, "tuned tuned", id="system's buffers"),
        pytest.param(
            *(TUNED, applied(sockets=(udp(7411, 425_984, 425_984),), limits=LIMITS_CUT), None),
            *("kernel_limit kernel_limit",),
            id="kernel's limit",
        ),
        pytest.param(
            *(SIZED, applied(begin_sockets=GRANTED, limits=LIMITS, end={}), TRAFFIC, "kernel_limit kernel_limit"),
            id="kernel's limit of a connection that ended",
        ),
        pytest.param(
            TUNED, applied(sockets=(SENDING, LARGE, udp(7411)), limits=LIMITS), None, "tuned", id="one small buffer"
        ),
        pytest.param(IN_115, applied(sockets=SOCKETS_OF_115, limits=FAR), None, "tuned", id="port of the domain"),
        pytest.param(ETH1, carried(20 * MB, 900), TRAFFIC, "interface", id="another interface"),
        pytest.param(ETH1, carried(900 * MB, 0), TRAFFIC, "interface", id="another way"),
        pytest.param(
            replace(ETH1, vendor="fastdds"), carried(MB, 0, memory=SHARED), TRAFFIC, "interface", id="memory instead"
        ),
        pytest.param(MEMORY_OFF, applied(memory=ZENOH), None, "shared_memory", id="memory is mapped"),
        pytest.param(MEMORY_OFF, applied(memory=ZENOH, **LOOPBACK), TRAFFIC, "shared_memory", id="memory was used"),
        pytest.param(MEMORY_ON, applied(), None, "shared_memory", id="none is mapped"),
        pytest.param(MEMORY_ON, TCP_ONLY, TRAFFIC, "memory_namespace", id="other side does not see memory"),
        pytest.param(Asked("fastdds"), UNSERVED, Traffic(20, 0, 100_000), "memory_namespace", id="unserved port"),
        pytest.param(
            *(Asked("fastdds"), applied(memory=(replace(segment(), is_here=False),)), None, "memory_namespace"),
            id="another file of that name",
        ),
    ],
)
def test_what_is_not_applied_is_named(asked, read_back, traffic, settings, sentences):
    found = to_json(differences(asked, read_back, traffic))
    assert " ".join(each["setting"] for each in found) == settings
    assert {tuple(each) for each in found} == {("setting", "asked", "applied", "words")}
    sentences(*(f"{each['asked']} | {each['applied']} | {each['words']}" for each in found))


@pytest.mark.parametrize(
    ("asked", "read_back", "traffic"),
    [
        pytest.param(UDP, applied(sockets=(udp(7411),), memory=ZENOH), None, id="memory of another middleware"),
        pytest.param(
            UDP,
            applied(sockets=(udp(7411),), memory=(replace(segment(), is_deleted=True),)),
            None,
            id="memory of an ended one",
        ),
        pytest.param(LARGE_DATA, applied(sockets=(udp(7411), tcp()), memory=SHARED), None, id="tcp and memory"),
        pytest.param(TUNED, applied(sockets=(SENDING, LARGE), limits=LIMITS), None, id="large buffers"),
        pytest.param(
            *(replace(TUNED, domain_id=12), applied(sockets=(udp(10_411, 8_000_000), udp(7000), SENDING)), None),
            id="ports of the domain",
        ),
        pytest.param(
            *(replace(TUNED, domain_id=200), applied(sockets=(udp(10_411, 8_000_000), udp(7000), SENDING)), None),
            id="no port of the domain",
        ),
        pytest.param(IN_115, applied(sockets=SOCKETS_OF_115), None, id="a port that the kernel chose only sends"),
        pytest.param(replace(ETH1, interface="lo"), carried(20 * MB, 900), TRAFFIC, id="the asked interface"),
        pytest.param(ETH1, carried(20 * MB, 900), None, id="before the end it could still come"),
        pytest.param(MEMORY_ON, applied(memory=ZENOH), None, id="memory on"),
        pytest.param(MEMORY_OFF, applied(), None, id="memory off"),
        pytest.param(Asked("fastdds"), UNSERVED, None, id="nothing was sent to the unserved port"),
        pytest.param(Asked("fastdds"), UNSERVED, Traffic(20, 1, 100_000), id="a reply came all the same"),
        pytest.param(Asked("socket"), applied(sockets=(tcp(),)), None, id="default of sockets is tcp"),
        pytest.param(
            *(
                replace(SIZED, receive_buffer_bytes=4_194_304, send_buffer_bytes=4_194_304),
                applied(sockets=GRANTED),
                None,
            ),
            id="buffers of a connection",
        ),
        pytest.param(SHM, applied(memory=None), None, id="memory unknown"),
        pytest.param(MEMORY_ON, applied(memory=None), None, id="zenoh's memory unknown"),
        pytest.param(TUNED, applied(sockets=None), None, id="sockets unknown"),
        pytest.param(LARGE_DATA, applied(sockets=None), None, id="tcp unknown"),
        pytest.param(
            TUNED,
            applied(
                sockets=(LARGE, udp(7411, 8_000_000), udp(7000, 8_000_000), SENDING),
                limits=LIMITS,
                begin=counted(lo=(0, 0)),
                end=counted(lo=(20 * MB, 20 * MB)),
            ),
            TRAFFIC,
            id="tuned run",
        ),
    ],
)
def test_an_honest_run_has_no_difference(asked, read_back, traffic):
    assert differences(asked, read_back, traffic) == ()


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


def test_a_connection_that_ended_with_the_other_side_carried_the_messages():
    assert differences(Asked("socket"), applied(begin_sockets=(tcp(),), sockets=(), end={})) == ()
    assert differences(Asked("socket"), applied(begin_sockets=(), sockets=(), end={})) != ()


def there_and_back(value):
    return from_json(type(value), json.loads(json.dumps(to_json(value))))


def test_what_is_read_now_comes_back():
    ended = read_applied(read_applied())
    assert ended.end.read_ns > 0
    assert ended.end.monotonic_ns > ended.begin.monotonic_ns
    assert there_and_back(ended) == ended
    assert there_and_back(Applied(ended.begin)) == Applied(ended.begin)


@pytest.mark.parametrize(
    "record",
    [
        applied(sockets=(udp(7411), tcp(7, 8)), memory=(segment(),), begin=counted(lo=(1, 2)), end=counted(lo=(3, 4))),
        applied(sockets=None),
        Asked("zenoh", 5, shared_memory=False, interface="eth0"),
    ],
)
def test_a_drawn_one_comes_back(record):
    assert there_and_back(record) == record


def test_fields_of_a_newer_version_are_skipped_and_those_of_an_older_one_have_defaults():
    data = to_json(applied(sockets=(tcp(),), begin=counted(lo=(1, 2))))
    data["later"] = data["begin"]["later"] = data["begin"]["sockets"][0]["later"] = {"x": 1}
    data["begin"]["sockets"][0]["tcp"]["later"] = 1
    del data["begin"]["groups"], data["begin"]["interfaces"]["lo"]["sent_packets"], data["path"]
    read = from_json(Applied, data)
    assert read == applied(sockets=(tcp(),), begin=counted(lo=(1, 2)))


def test_what_cannot_be_missing():
    with pytest.raises(ValueError, match="vendor"):
        from_json(Asked, {})
    with pytest.raises(ValueError, match="begin"):
        from_json(Applied, {})


def test_drops_of_the_own_sockets_during_the_run():
    begin = Snapshot(sockets=(udp(1, inode=1, dropped=5), udp(2, inode=2, dropped=7)))
    end = Snapshot(sockets=(udp(1, inode=1, dropped=8), udp(3, inode=3, dropped=2)))
    assert Applied(begin, end).socket_drops() == 5
    assert Applied(begin).socket_drops() is None
    assert Applied(begin, Snapshot()).socket_drops() is None

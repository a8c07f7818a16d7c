from __future__ import annotations

import json

import pytest
from snapshots import applied, counted, segment, tcp, udp

from dds_trace.recorder.applied.applied import Applied, Snapshot, read_applied
from dds_trace.recorder.applied.asked import Asked
from dds_trace.recorder.records import from_json


def there_and_back(value):
    return from_json(type(value), json.loads(json.dumps(value.to_json())))


def test_what_is_read_now_comes_back():
    ended = read_applied(read_applied())
    assert ended.end.read_ns > 0
    assert ended.end.monotonic_ns > ended.begin.monotonic_ns
    assert there_and_back(ended) == ended
    assert there_and_back(Applied(ended.begin)) == Applied(ended.begin)


def test_a_drawn_one_comes_back():
    drawn = applied(
        sockets=(udp(7411), tcp(7, 8)), memory=(segment(),), begin=counted(lo=(1, 2)), end=counted(lo=(3, 4))
    )
    assert there_and_back(drawn) == drawn
    assert there_and_back(applied(sockets=None)).begin.sockets is None


def test_asked_comes_back():
    asked = Asked("zenoh", 5, shared_memory=False, interface="eth0")
    assert there_and_back(asked) == asked
    assert asked.to_json()["shared_memory"] is False


def test_fields_of_a_newer_version_are_skipped_and_those_of_an_older_one_have_defaults():
    data = applied(sockets=(tcp(),), begin=counted(lo=(1, 2))).to_json()
    data["later"] = data["begin"]["later"] = data["begin"]["sockets"][0]["later"] = {"x": 1}
    data["begin"]["sockets"][0]["tcp"]["later"] = 1
    del data["begin"]["groups"], data["begin"]["interfaces"]["lo"]["sent_packets"], data["path"]
    read = from_json(Applied, data)
    assert read == applied(sockets=(tcp(),), begin=counted(lo=(1, 2)))


def test_what_cannot_be_missing():
    with pytest.raises(TypeError, match="vendor"):
        from_json(Asked, {})
    with pytest.raises(TypeError, match="begin"):
        from_json(Applied, {})


def test_drops_of_the_own_sockets_during_the_run():
    begin = Snapshot(sockets=(udp(1, inode=1, dropped=5), udp(2, inode=2, dropped=7)))
    end = Snapshot(sockets=(udp(1, inode=1, dropped=8), udp(3, inode=3, dropped=2)))
    assert Applied(begin, end).socket_drops() == 5
    assert Applied(begin).socket_drops() is None
    assert Applied(begin, Snapshot()).socket_drops() is None

import fcntl
import mmap
import os
from subprocess import PIPE, Popen

import pytest
from applied_pair import relaying

from dds_trace.recorder.applied import memory
from dds_trace.recorder.applied.memory import SHM, Library, parse_libraries, parse_maps, ports_of_others, read_memory
from dds_trace.recorder.applied.vendors import PORT, SEGMENT, memory_owner
from dds_trace.recorder.domains import domain_port_range

MAPS = """\
7f0000000000-7f0000100000 rw-s 00000000 00:1b 710                        /dev/shm/fastrtps_8624f4c58b8ae239
7f0000200000-7f0000201000 rw-s 00000000 00:1b 714                        /dev/shm/fastrtps_port10661
7f0000201000-7f0000203000 rw-s 00001000 00:1b 714                        /dev/shm/fastrtps_port10661
7f0000300000-7f0000302000 rw-s 00000000 00:1b 694                        /dev/shm/fastrtps_da045ca839c012b7 (deleted)
7f0000400000-7f0000401000 rw-s 00000000 00:01 98310                      /SYSV00000000 (deleted)
7f0000500000-7f0000501000 r-xp 00000000 08:01 1234                       /usr/lib/libfastrtps.so.2.14.5
7f0000501000-7f0000502000 r--p 00001000 08:01 1234                       /usr/lib/libfastrtps.so.2.14.5
7f0000600000-7f0000601000 r-xp 00000000 08:01 1235                       /opt/x/cyclonedds.libs/libddsc-ad12c33a.so.11.0.1
7f0000700000-7f0000701000 r-xp 00000000 08:01 1236                       /usr/lib/libc.so.6
7f0000800000-7f0000801000 rw-p 00000000 00:00 0                          [heap]
"""


def test_mappings_of_one_file_are_one():
    mapped = parse_maps(MAPS)
    assert {name: each.size_bytes for name, each in mapped.items()} == {
        "fastrtps_8624f4c58b8ae239": 0x100000,
        "fastrtps_port10661": 0x3000,
        "fastrtps_da045ca839c012b7": 0x2000,
        "SYSV00000000": 0x1000,
    }
    assert [name for name, each in mapped.items() if each.is_deleted] == ["fastrtps_da045ca839c012b7"]
    assert mapped["fastrtps_port10661"].inode == 714
    assert mapped["fastrtps_port10661"].device == os.makedev(0, 0x1B)


@pytest.mark.parametrize(
    ("name", "owner"),
    [
        ("fastrtps_8624f4c58b8ae239", ("fastdds", SEGMENT)),
        ("fastdds_8624f4c58b8ae239", ("fastdds", SEGMENT)),
        ("fastrtps_port7411", ("fastdds", PORT)),
        ("fast_datasharing_01.0f.45_0.0.1.3", ("fastdds", SEGMENT)),
        ("2879179048.zenoh", ("zenoh", SEGMENT)),
        ("iceoryx_mgmt", ("cyclonedds", SEGMENT)),
        ("SYSV00000000", ("connext", SEGMENT)),
        ("lttng-ust-wait-6", None),
        ("sem.fastrtps_port7411_mutex", None),
        ("fastrtps_port7411_el", None),
    ],
)
def test_whose_file_it_is_by_its_name(name, owner):
    assert memory_owner(name) == owner


def test_libraries_are_named_once_with_the_version_of_their_file():
    assert parse_libraries(MAPS) == (
        Library("libddsc-ad12c33a.so.11.0.1", "cyclonedds", "11.0.1"),
        Library("libfastrtps.so.2.14.5", "fastdds", "2.14.5"),
    )


def test_a_short_version_of_a_file_stays_where_no_distribution_tells_more(monkeypatch):
    monkeypatch.setattr("dds_trace.recorder.applied.memory._distribution_version", lambda _: "")
    line = MAPS.splitlines()[5].replace("2.14.5", "2.14") + "\n"
    assert parse_libraries(line) == (Library("libfastrtps.so.2.14", "fastdds", "2.14"),)
    monkeypatch.setattr("dds_trace.recorder.applied.memory._distribution_version", lambda _: "2.14.5")
    assert parse_libraries(line) == (Library("libfastrtps.so.2.14", "fastdds", "2.14.5"),)


@pytest.fixture
def segment():
    path = SHM / f"fastrtps_{os.getpid():016x}"
    path.write_bytes(bytes(12_000))
    try:
        with path.open("r+b") as file, mmap.mmap(file.fileno(), 0):
            yield path
    finally:
        path.unlink(missing_ok=True)


def seen(path, folder=SHM):
    (only,) = [each for each in read_memory(folder=folder) if each.name == path.name]
    return only


def test_a_mapped_segment_has_size_and_owner(segment):
    read = seen(segment)
    assert (read.middleware, read.role, read.size_bytes, read.owner_uid) == ("fastdds", SEGMENT, 12_000, os.getuid())
    assert (read.is_here, read.is_deleted, read.is_in_use) == (True, False, True)


def test_a_segment_is_own_while_its_lock_is_open(segment):
    assert (seen(segment).is_own, seen(segment).is_served, seen(segment).is_foreign_segment) == (False, False, True)
    lock = segment.with_name(segment.name + "_el")
    try:
        with lock.open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            assert (seen(segment).is_own, seen(segment).is_served) == (True, True)
            assert not seen(segment).is_foreign_segment
    finally:
        lock.unlink()


@pytest.mark.parametrize(("suffix", "lock"), [("_el", fcntl.LOCK_EX), ("_sl", fcntl.LOCK_SH)])
def test_a_file_is_served_while_its_lock_is_held_and_abandoned_while_it_only_exists(tmp_path, segment, suffix, lock):
    def state():
        read = seen(segment, tmp_path)
        return read.is_served, read.is_abandoned

    assert state() == (False, False)
    path = tmp_path / (segment.name + suffix)
    path.touch()
    assert state() == (False, True)
    with path.open() as file:
        fcntl.flock(file, lock)
        assert state() == state() == (True, False)
    with path.open() as file:  # the look has left no lock behind
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


def test_of_a_lock_that_cannot_be_opened_nothing_is_known(tmp_path, segment):
    (tmp_path / (segment.name + "_el")).symlink_to(tmp_path / (segment.name + "_el"))  # ELOOP, for root too
    assert (seen(segment, tmp_path).is_served, seen(segment, tmp_path).is_abandoned) == (None, False)


def test_a_zenoh_segment_is_removed_by_the_last_process_that_locks_it(tmp_path):
    segment = tmp_path / "2879179048.zenoh"
    segment.touch()
    with segment.open() as own, Popen(["flock", "-s", segment, "cat"], stdin=PIPE, stdout=PIPE, bufsize=0) as other:
        fcntl.flock(own, fcntl.LOCK_SH)
        other.stdin.write(b"\n")
        assert other.stdout.readline() == b"\n"  # it has its lock
        memory.remove_own_segments("zenoh", tmp_path)
        assert segment.exists()
        other.communicate()
        memory.remove_own_segments("zenoh", tmp_path)
    assert not segment.exists()


@pytest.mark.middleware
def test_the_port_of_a_killed_fast_dds_is_served_no_more(domain_id):
    pytest.importorskip("rclpy")
    with relaying("ros2", domain_id) as relay:
        name = next(
            each.name
            for each in read_memory(relay.pid)
            if each.role == PORT and each.port_number in domain_port_range(domain_id)
        )
        with (SHM / name).open("r+b") as file, mmap.mmap(file.fileno(), 0):
            alive = seen(SHM / name)
            assert (alive.is_served, alive.is_abandoned, alive.is_unserved_port) == (True, False, False)
            relay.kill()
            relay.wait()
            killed = seen(SHM / name)
            assert (killed.is_served, killed.is_abandoned, killed.is_unserved_port) == (False, True, False)


def test_a_removed_file_is_a_remainder(segment):
    segment.unlink()
    read = seen(segment)
    assert (read.is_deleted, read.is_here, read.is_in_use, read.owner_uid) == (True, True, False, None)


def test_a_file_that_is_removed_during_the_look_is_a_remainder(segment, monkeypatch):
    def remove(_):
        segment.unlink(missing_ok=True)
        return iter(())

    monkeypatch.setattr("dds_trace.recorder.applied.memory.open_files", remove)
    assert (seen(segment).is_here, seen(segment).is_deleted) == (True, True)


def test_a_file_of_the_same_name_in_another_dev_shm_is_not_the_mapped_one(segment, tmp_path):
    assert not seen(segment, tmp_path).is_here
    (tmp_path / segment.name).write_bytes(b"x")
    read = seen(segment, tmp_path)
    assert (read.is_here, read.owner_uid) == (False, None)
    assert read.size_bytes >= 12_000  # what is mapped, in whole pages


def test_of_a_process_that_is_gone_nothing_is_known():
    assert read_memory(1 << 22) is None


def test_queues_of_another_user_in_the_domain_are_found(tmp_path, monkeypatch):
    for name in ("fastrtps_port8661", "fastrtps_port8661_el", "fastrtps_port7411", "fastrtps_00000000000000aa"):
        (tmp_path / name).touch()
    (tmp_path / "fastrtps_port8663").touch()
    (tmp_path / "fastrtps_port8663_sl").touch()
    assert ports_of_others(domain_port_range(5), tmp_path) == {}
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    # Of the first, the lock file is there and nobody holds it: its receiver was killed.
    assert ports_of_others(domain_port_range(5), tmp_path) == {"fastrtps_port8663": os.getuid()}

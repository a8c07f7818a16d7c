"""A Cyclone DDS writer that says what its own statistics count (`dds_create_statistics`), and a reader for it.

cyclone_statistics.py write COUNT BYTES     prints rexmit_bytes when all is acknowledged
cyclone_statistics.py read                  until it is ended
"""

import ctypes
import re
import signal
import sys
import time
from pathlib import Path

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import make_idl_struct
from cyclonedds.idl.types import sequence, uint8
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

DOMAIN, PERIOD_S = 30, 0.005
FOREVER_NS = (1 << 63) - 1
RELIABLE = Qos(Policy.Reliability.Reliable(FOREVER_NS), Policy.History.KeepAll)


Octets = make_idl_struct("Octets", "Octets", {"octets": sequence[uint8]})


class _KeyValue(ctypes.Structure):
    _fields_ = (("name", ctypes.c_char_p), ("kind", ctypes.c_int), ("value", ctypes.c_uint64))


class _Statistics(ctypes.Structure):
    _fields_ = (
        ("entity", ctypes.c_int32),
        ("opaque", ctypes.c_uint64),
        ("time", ctypes.c_int64),
        ("count", ctypes.c_size_t),
    )


def statistics_of(entity: int) -> dict[str, int]:
    loaded = re.search(r"/\S*libddsc\S*", Path("/proc/self/maps").read_text())
    library = ctypes.CDLL(loaded[0])
    library.dds_create_statistics.restype = ctypes.POINTER(_Statistics)
    found = library.dds_create_statistics(entity)
    values = (_KeyValue * found.contents.count).from_address(
        ctypes.addressof(found.contents) + ctypes.sizeof(_Statistics)
    )
    return {one.name.decode(): one.value for one in values}


def main() -> None:
    participant = DomainParticipant(DOMAIN)
    topic = Topic(participant, "octets", Octets)
    if sys.argv[1] == "read":
        reader = DataReader(participant, topic, qos=RELIABLE)
        print("ready", flush=True)
        signal.pause()
        del reader
    count, size = map(int, sys.argv[2:])
    writer = DataWriter(participant, topic, qos=RELIABLE)
    while not writer.get_matched_subscriptions():
        time.sleep(0.01)
    content = Octets(list(bytes(size)))
    for _ in range(count):
        writer.write(content)
        time.sleep(PERIOD_S)
    writer.wait_for_acks(60_000_000_000)
    print(statistics_of(writer._ref)["rexmit_bytes"], flush=True)


if __name__ == "__main__":
    main()

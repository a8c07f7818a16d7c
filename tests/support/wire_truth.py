"""What was on an emulated link, from the forwarder's list of whole frames, and how often each sample went over it.

Another way than the capture's: datagrams are put together first, then read from their first octet to their last.
"""

from __future__ import annotations

import struct
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

_RECORD = struct.Struct("<BBI")


@dataclass(frozen=True)
class Frame:
    side: int
    dropped: bool
    octets: bytes


@dataclass(frozen=True)
class Sending:
    """A sample on its way once: the whole of it (part 0), or a fragment; to a group if `target` is empty."""

    part: int
    target: bytes
    dropped: bool

    def holds_some_of(self, other: Sending) -> bool:
        return (self.part == other.part or 0 in (self.part, other.part)) and self.target in (b"", other.target)


@dataclass
class Truth:
    """Of one side's frames.

    Attributes:
        bytes: of all IPv4 frames with UDP or TCP.
        sent: identity of a sample -> its sendings in their order, of user topics alone.
        submessages: by kind, of all RTPS packets that were sent whole.
        unfinished: datagrams of which a fragment never came.
        tcp_again_segments, tcp_again_bytes: TCP segments with octets that the connection had sent before, and those octets.
        tcp_dropped_segments: TCP segments with payload that the link dropped.
    """

    bytes: int = 0
    sent: defaultdict[tuple, list[Sending]] = field(default_factory=lambda: defaultdict(list))
    submessages: Counter[int] = field(default_factory=Counter)
    unfinished: int = 0
    tcp_again_segments: int = 0
    tcp_again_bytes: int = 0
    tcp_dropped_segments: int = 0

    def earlier(self) -> Iterator[tuple[Sending, list[Sending]]]:
        """Each sending that repeats something, with those before it that hold the same octets."""
        for sendings in self.sent.values():
            for number, sending in enumerate(sendings):
                same = [one for one in sendings[:number] if one.holds_some_of(sending)]
                if same:
                    yield sending, same

    @property
    def again(self) -> int:
        return sum(1 for _ in self.earlier())

    @property
    def needless(self) -> int:
        return sum(not all(one.dropped for one in same) for _, same in self.earlier())

    @property
    def made_good(self) -> int:
        """Sendings that the link dropped, of what had not come through, and that were followed by another."""
        found = 0
        for sendings in self.sent.values():
            for number, sending in enumerate(sendings):
                before = [one for one in sendings[:number] if one.holds_some_of(sending)]
                after = [one for one in sendings[number + 1 :] if sending.holds_some_of(one)]
                found += sending.dropped and bool(after) and all(one.dropped for one in before)
        return found

    @property
    def dropped(self) -> int:
        return sum(one.dropped for sendings in self.sent.values() for one in sendings)


def read_frames(path: Path) -> Iterator[Frame]:
    data, at = path.read_bytes(), 0
    while at + _RECORD.size <= len(data):
        side, dropped, length = _RECORD.unpack_from(data, at)
        at += _RECORD.size
        if at + length > len(data):
            return
        yield Frame(side, bool(dropped), data[at : at + length])
        at += length


def truth_of(path: Path, side: int) -> Truth:
    truth = Truth()
    open_datagrams: dict[bytes, tuple[bytearray, list[bool]]] = {}
    octets_sent: dict[bytes, set[int]] = {}
    for frame in read_frames(path):
        octets = frame.octets
        if frame.side != side or octets[12:14] != b"\x08\x00" or octets[23] not in (6, 17):
            continue
        truth.bytes += len(octets)
        if octets[23] == 6:
            _read_segment(truth, octets, frame.dropped, octets_sent)
            continue
        header_bytes = (octets[14] & 15) * 4
        (total, ip_id, flags) = struct.unpack_from(">HHH", octets, 16)
        content = octets[14 + header_bytes : 14 + total]
        key = octets[26:34] + struct.pack(">H", ip_id)
        offset, more = (flags & 0x1FFF) * 8, bool(flags & 0x2000)
        if offset == 0:
            open_datagrams[key] = (bytearray(), [])
        datagram, fates = open_datagrams[key]
        assert len(datagram) == offset, "a sender's fragments go out in their order"
        datagram += content
        fates.append(frame.dropped)
        if not more:
            del open_datagrams[key]
            _read(truth, bytes(datagram), octets[30:34], any(fates))
    truth.unfinished = len(open_datagrams)
    return truth


def _read_segment(truth: Truth, octets: bytes, dropped: bool, octets_sent: dict[bytes, set[int]]) -> None:
    """Every octet that a connection sends is kept by its number, so nothing has to be known of windows or order."""
    (total,) = struct.unpack_from(">H", octets, 16)
    at = 14 + (octets[14] & 15) * 4
    (sequence,) = struct.unpack_from(">I", octets, at + 4)
    size = 14 + total - at - (octets[at + 12] >> 4) * 4
    if size <= 0 or octets[at + 13] & 0x06:
        return
    before = octets_sent.setdefault(octets[26:34] + octets[at : at + 4], set())
    numbers = {(sequence + number) % (1 << 32) for number in range(size)}
    again = len(numbers & before)
    before |= numbers
    truth.tcp_again_bytes += again
    truth.tcp_again_segments += bool(again)
    truth.tcp_dropped_segments += dropped


def _read(truth: Truth, datagram: bytes, destination: bytes, dropped: bool) -> None:
    if datagram[8:12] != b"RTPS":
        return
    prefix, at = datagram[16:28], 28
    target = b"" if destination[0] >= 224 else destination + datagram[2:4]
    while at < len(datagram):
        kind, flags = datagram[at : at + 2]
        order = "<" if flags & 1 else ">"
        (length,) = struct.unpack_from(order + "H", datagram, at + 2)
        if length == 0 and kind not in (1, 9):
            length = len(datagram) - at - 4
        truth.submessages[kind] += 1
        body = datagram[at + 4 : at + 4 + length]
        if kind in (0x15, 0x16) and body[11] & 0xC0 != 0xC0:
            number = struct.unpack_from(order + "iI", body, 12)
            parts = (0,)
            if kind == 0x16:
                first, count = struct.unpack_from(order + "IH", body, 20)
                parts = range(first, first + count)
            for part in parts:
                truth.sent[prefix, body[8:12], number].append(Sending(part, target, dropped))
        at += 4 + length

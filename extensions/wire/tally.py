"""Captured frames counted by class and by message."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from dds_trace.recorder.payloads.stamp import PROBE_RUN_ID, Stamp

from .classes import AGAIN, RANK, TcpFlows, WireClass, class_of
from .counts import RunTally
from .format import Direction, MessageRows
from .frames import TCP, UDP, Frame, FrameBatch, read_frames
from .messages import MULTICAST, Copy, SendLedger, SentSample, message_row, message_rows, pack_rows, stamp_at
from .packet_filter import PortRange
from .rtps import HEADER_BYTES, INFO_DST, PREFIX_BYTES, FragmentTable, Piece, Submessage, walk_submessages

_PACKET_OTHERHOST, _PACKET_OUTGOING = 3, 4  # <linux/if_packet.h>
_UDP_BYTES = 8
_FIRST_GROUP = 224 << 24
_TCP_SEQUENCE = struct.Struct(">I")
_FORGET_EVERY_NS = 1_000_000_000
_ROWS_AT_ONCE = 4096
"""Rows that wait as Python numbers, five times as large as in an array."""


class Sender(NamedTuple):
    """Where a packet comes from (`prefix` of the participant, empty if it is not RTPS) and goes to (MULTICAST for a group)."""

    interface: str
    direction: Direction
    prefix: bytes
    destination: int


class Stream(NamedTuple):
    direction: Direction
    interface: str
    prefix: bytes
    writer: int


class Datagram(NamedTuple):
    kind: WireClass | None
    sender: Sender


class WireTally:
    """Counts frames of all interfaces: `run` since `begin`, `beginnings` (fields of `WireCounts`) since the capture began.

    RTPS of participants that neither use one of `domain_ports` nor talk to one that does is another domain's (empty: all counts).
    """

    def __init__(self, domain_ports: Sequence[PortRange] = ()) -> None:
        self.run = RunTally()
        self.beginnings: dict[str, int] = {}
        self._tcp = TcpFlows()
        self._domain_ports = frozenset(port for ports in domain_ports for port in range(ports.first, ports.last + 1))
        self._participants: set[bytes] = set()
        self._ledger: SendLedger[Stream] = SendLedger()
        self._fragments: FragmentTable[Datagram] = FragmentTable()
        self._last_heartbeat_ns: dict[tuple[Sender, int], int] = {}
        self._rows: list[tuple[int, ...]] = []
        self._packed: list[MessageRows] = []
        self._forgot_ns = 0
        self._late_before = self._lost_before = 0

    def begin(self) -> None:
        self.run = RunTally()
        self._rows.clear()
        self._packed.clear()
        self._late_before = self._ledger.late_repeats
        self._lost_before = self._fragments.lost_trails

    @property
    def late_repeats(self) -> int:
        return self._ledger.late_repeats - self._late_before

    @property
    def unfollowed_datagrams(self) -> int:
        return self._fragments.lost_trails - self._lost_before

    def take_rows(self, run_id: int | None = None) -> MessageRows:
        self._make_rows(self._ledger.take(run_id))
        rows = message_rows([*self._packed, pack_rows(self._rows)])
        self._rows.clear()
        self._packed.clear()
        selected: MessageRows = rows[rows["run_id"] != PROBE_RUN_ID if run_id is None else rows["run_id"] == run_id]
        return selected

    def add(self, batch: FrameBatch, interface: str, *, is_loopback: bool, wall_to_monotonic_ns: int) -> None:
        memory = batch.memory.data
        for frame in read_frames(batch, wall_to_monotonic_ns):
            if frame.packet_type != _PACKET_OTHERHOST:
                outgoing = Direction.SENT if frame.packet_type == _PACKET_OUTGOING else Direction.RECEIVED
                self._count(frame, memory, interface, Direction.LOCAL if is_loopback else outgoing)
        self.run.packets += len(batch)
        last_ns = int(batch.wall_ns[-1]) + wall_to_monotonic_ns
        if last_ns - self._forgot_ns > _FORGET_EVERY_NS:
            self._forgot_ns = last_ns
            self._make_rows(self._ledger.forget(last_ns))

    def _make_rows(self, forgotten: Iterable[tuple[Stream, SentSample]]) -> None:
        for stream, sample in forgotten:
            row = message_row(sample, stream.direction)
            if row is not None:
                self._rows.append(row)
        if len(self._rows) >= _ROWS_AT_ONCE:
            self._packed.append(pack_rows(self._rows))
            self._rows.clear()

    def _count(self, frame: Frame, memory: memoryview, interface: str, direction: Direction) -> None:
        if frame.protocol == TCP:
            self._count_tcp(frame, memory, direction)
        elif frame.fragment_offset:
            self._count_fragment(frame, memory, interface, direction)
        elif frame.is_rtps:
            self._count_rtps(frame, memory, interface, direction)
        elif frame.protocol == UDP:
            sender = Sender(interface, direction, b"", 0)
            self.run.count_frame(frame, WireClass.UDP_OTHER, direction)
            if frame.more_fragments:
                self._fragments.begin(_fragment_key(frame, interface, direction), Datagram(WireClass.UDP_OTHER, sender))

    def _count_tcp(self, frame: Frame, memory: memoryview, direction: Direction) -> None:
        at = frame.transport
        if at + 20 > frame.seen_end:
            return
        flow = (frame.source, frame.source_port, frame.destination, frame.destination_port, direction)
        (sequence,) = _TCP_SEQUENCE.unpack_from(memory, at + 4)
        payload_bytes = frame.transport_end - at - (memory[at + 12] >> 4) * 4
        kind, again_bytes = self._tcp.note(flow, sequence, payload_bytes, memory[at + 13])
        self.run.count_frame(frame, kind, direction)
        if direction is not Direction.RECEIVED:
            self.run.tcp_again_bytes += again_bytes

    def _count_rtps(self, frame: Frame, memory: memoryview, interface: str, direction: Direction) -> None:
        packet = frame.transport + _UDP_BYTES
        prefix = bytes(memory[packet + PREFIX_BYTES.start : packet + PREFIX_BYTES.stop])
        multicast = frame.destination >= _FIRST_GROUP
        destination = MULTICAST if multicast else frame.destination << 16 | frame.destination_port
        sender = Sender(interface, direction, prefix, destination)
        if not self._is_ours(frame, memory, packet, prefix):
            self.run.foreign_packets += 1
            if frame.more_fragments:
                self._fragments.begin(_fragment_key(frame, interface, direction), Datagram(None, sender))
            return
        piece_end = frame.transport_end
        datagram_end = frame.transport + frame.datagram_bytes
        seen_end = min(frame.seen_end, datagram_end)
        walk = walk_submessages(memory, packet + HEADER_BYTES, seen_end, datagram_end)
        kinds = self._note(walk.submessages, sender, frame.time_ns, memory, seen_end)
        principal = min(kinds, key=RANK.__getitem__, default=WireClass.RTPS_OTHER)
        self.run.count_frame(frame, principal, direction)
        self.run.move_bytes(kinds, principal, direction)
        if frame.more_fragments:
            seen_whole = walk.next_at >= piece_end or frame.seen_end >= piece_end
            self.run.unseen_headers += not seen_whole
            self._fragments.begin(
                _fragment_key(frame, interface, direction),
                Datagram(principal, sender),
                frame.datagram_bytes,
                walk.next_at - frame.transport if seen_whole else -1,
                bytes(memory[walk.next_at : piece_end]) if seen_whole else b"",
            )
        elif walk.next_at < datagram_end:
            self.run.unseen_headers += 1

    def _count_fragment(self, frame: Frame, memory: memoryview, interface: str, direction: Direction) -> None:
        piece = Piece(
            frame.fragment_offset,
            memory,
            frame.transport,
            frame.seen_end,
            frame.transport_end,
            not frame.more_fragments,
        )
        continued = self._fragments.continue_with(_fragment_key(frame, interface, direction), piece)
        if continued is None:
            self.run.count_frame(frame, WireClass.FRAGMENT_UNKNOWN, direction)
            return
        datagram, submessages = continued
        if datagram.kind is None:
            self.run.foreign_packets += 1
            return
        self.run.count_frame(frame, datagram.kind, direction)
        if submessages:
            kinds = self._note(submessages, datagram.sender, frame.time_ns, memory, frame.seen_end)
            self.run.move_bytes(kinds, datagram.kind, direction)

    def _is_ours(self, frame: Frame, memory: memoryview, packet: int, prefix: bytes) -> bool:
        """Return whether a packet is of our domains, and remember its sender if so.

        Cyclone DDS has its unicast ports from the ephemeral range, and an announcement to the domain's port may be
        lost; then a packet to a participant of ours (INFO_DST comes first) identifies its sender.
        """
        if not self._domain_ports or prefix in self._participants:
            return True
        spoken_to = packet + HEADER_BYTES + 4
        is_ours = (
            frame.destination_port in self._domain_ports
            or frame.source_port in self._domain_ports
            or (
                spoken_to + len(prefix) <= frame.seen_end
                and memory[packet + HEADER_BYTES] == INFO_DST
                and bytes(memory[spoken_to : spoken_to + len(prefix)]) in self._participants
            )
        )
        if is_ours:
            self._participants.add(prefix)
        return is_ours

    def _note(
        self, submessages: Sequence[Submessage], sender: Sender, time_ns: int, memory: memoryview, seen_end: int
    ) -> Counter[WireClass]:
        bytes_of: Counter[WireClass] = Counter()
        for submessage in submessages:
            kind = class_of(submessage.kind, submessage.writer)
            if kind is None:
                continue
            if kind in AGAIN and self._note_data(submessage, sender, time_ns, memory, seen_end):
                kind = AGAIN[kind]
            if kind is WireClass.SPDP:
                self.beginnings.setdefault("first_spdp_ns", time_ns)
            if submessage.asks:
                self.run.requests += kind in (WireClass.ACKNACK, WireClass.NACK_FRAG)
            elif kind is WireClass.HEARTBEAT:
                self._note_heartbeat(sender, submessage.writer, time_ns, without_data=not bytes_of)
            tally = self.run.classes[kind, sender.direction]
            tally.submessages += 1
            tally.fragments += submessage.fragments
            bytes_of[kind] += submessage.wire_bytes
        return bytes_of

    def _note_data(
        self, submessage: Submessage, sender: Sender, time_ns: int, memory: memoryview, seen_end: int
    ) -> bool:
        stamp: Stamp | None = None
        if submessage.payload_at is not None:
            stamp = stamp_at(memory, submessage.payload_at, seen_end)
        if stamp is not None:
            self.beginnings.setdefault("first_data_ns", time_ns)
            if stamp.relay_id:
                self.beginnings.setdefault("first_reply_ns", time_ns)
        copy = Copy(
            submessage.sequence,
            submessage.fragment,
            submessage.fragments,
            sender.destination,
            time_ns,
            submessage.sample_bytes,
        )
        stream = Stream(sender.direction, sender.interface, sender.prefix, submessage.writer)
        return self._ledger.note(stream, copy, stamp)

    def _note_heartbeat(self, sender: Sender, writer: int, time_ns: int, *, without_data: bool) -> None:
        self._ledger.note_heartbeat(Stream(sender.direction, sender.interface, sender.prefix, writer))
        if not without_data:
            return
        before_ns = self._last_heartbeat_ns.get((sender, writer))
        self._last_heartbeat_ns[sender, writer] = time_ns
        if before_ns is not None:
            self.run.heartbeat_gaps_ns.append(time_ns - before_ns)


def _fragment_key(frame: Frame, interface: str, direction: Direction) -> tuple[object, ...]:
    return (interface, direction, frame.source, frame.destination, frame.ip_id, frame.protocol)

"""The classic BPF program that the kernel runs over each frame (SO_ATTACH_FILTER): it keeps the headers (docs/reference/wire.md)."""

from __future__ import annotations

import ctypes
import socket
import struct
from collections.abc import Sequence
from typing import NamedTuple

SO_ATTACH_FILTER = 26  # <asm-generic/socket.h>
WHOLE_FRAME = 0x40000
SHORT_BYTES = 192
"""Captured at least: all headers up to a first DATA's stamp."""
LAST_HEADER_BYTES = 104
"""Captured from the last submessage's header on: DATA_FRAG's 36 bytes, and 62 of the payload for our stamp."""
TCP_HEADERS_BYTES = 14 + 60 + 60
FOLLOWED_SUBMESSAGES = 32
"""Submessages that the program follows by their lengths; a packet with more is captured whole."""

_ETHERNET, _IPV4_BYTES, _UDP_BYTES, _RTPS_BYTES = 14, 20, 8, 20
_RTPS_MAGIC = int.from_bytes(b"RTPS", "big")
_PAD, _INFO_TS = 0x01, 0x09

# <linux/bpf_common.h>: class | size | mode, or class | operation | operand
_OPERATIONS = {
    "ldb": 0x30,
    "ldh": 0x28,
    "ldb_x": 0x50,
    "ldh_x": 0x48,
    "ldw_x": 0x40,
    "ld_len": 0x80,
    "ld_imm": 0x00,
    "ld_mem": 0x60,
    "ldx_mem": 0x61,
    "ldx_ip_header": 0xB1,
    "st": 0x02,
    "stx": 0x03,
    "add": 0x04,
    "add_x": 0x0C,
    "lsh": 0x64,
    "or_x": 0x4C,
    "sub": 0x14,
    "tax": 0x07,
    "txa": 0x87,
    "ja": 0x05,
    "jeq": 0x15,
    "jgt": 0x25,
    "jge": 0x35,
    "jset": 0x45,
    "jgt_x": 0x2D,
    "jge_x": 0x3D,
    "ret": 0x06,
    "ret_a": 0x16,
}
_LENGTH, _HEADER, _NEXT, _KIND, _HIGH_BYTE = range(5)


class PortRange(NamedTuple):
    first: int
    last: int


class _Step(NamedTuple):
    """One instruction, or a jump target (`operation` empty); without a label a jump goes to the next instruction."""

    operation: str
    operand: int = 0
    if_true: str = ""
    if_false: str = ""
    label: str = ""


def attach_filter(target: socket.socket, program: bytes) -> None:
    buffer = ctypes.create_string_buffer(program, len(program))
    count = len(program) // 8
    # struct sock_fprog: the native alignment puts the pointer where the kernel looks for it.
    target.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, struct.pack("@HP", count, ctypes.addressof(buffer)))


def wire_program(udp_ports: Sequence[PortRange], tcp_ports: Sequence[PortRange]) -> bytes:
    """Return the program that captures RTPS on any port, UDP and TCP on the given ones, and UDP's later IP fragments.

    RTPS is recognized by its first four bytes: Cyclone DDS takes unicast ports from the ephemeral range.
    """
    steps = [
        # First: the kernel's checker takes it for unset after any `ret` of a path without it.
        _Step("ld_len"),
        _Step("st", _LENGTH),
        *_branch("ldh", 12, "jeq", 0x0800, "ipv4"),
        _Step("ret", 0),
        _label("ipv4"),
        _Step("ldb", 23),
        _Step("jeq", socket.IPPROTO_TCP, "tcp"),
        _Step("jeq", socket.IPPROTO_UDP, "udp"),
        _Step("ret", 0),
        _label("tcp"),
        *_branch("ldh", 20, "jset", 0x1FFF, "reject_tcp"),
        _Step("ldx_ip_header", _ETHERNET),
        *_ports_match(tcp_ports, "tcp_captured"),
        _label("reject_tcp"),
        _Step("ret", 0),
        _label("tcp_captured"),
        _Step("ret", TCP_HEADERS_BYTES),
        _label("udp"),
        *_branch("ldh", 20, "jset", 0x1FFF, "later_fragment"),
        _Step("ldx_ip_header", _ETHERNET),
        # A load beyond a frame's end would reject it; other UDP may be shorter than RTPS's header.
        _Step("ld_len"),
        _Step("sub", _ETHERNET + _UDP_BYTES + _RTPS_BYTES),
        _Step("jge_x", 0, "", "not_rtps"),
        _Step("ldw_x", _ETHERNET + _UDP_BYTES),
        _Step("jeq", _RTPS_MAGIC, "rtps"),
        _label("not_rtps"),
        *_ports_match(udp_ports, "udp_captured"),
        _Step("ret", 0),
        _label("udp_captured"),
        _Step("ret", _ETHERNET + 60 + _UDP_BYTES),
        _label("later_fragment"),
        _Step("ret", WHOLE_FRAME),
        _label("rtps"),
        _Step("txa"),
        _Step("add", _ETHERNET + _UDP_BYTES + _RTPS_BYTES),
        _Step("st", _HEADER),
    ]
    for number in range(FOLLOWED_SUBMESSAGES):
        steps += _follow(number)
    steps += [
        _Step("ret", WHOLE_FRAME),
        _label("done"),
        _Step("ld_mem", _HEADER),
        _Step("add", LAST_HEADER_BYTES),
        _Step("jge", SHORT_BYTES, "long"),
        _Step("ret", SHORT_BYTES),
        _label("long"),
        _Step("ret_a"),
    ]
    return _assemble(steps)


def _label(name: str) -> _Step:
    return _Step("", label=name)


def _branch(load: str, position: int, test: str, value: int, target: str) -> list[_Step]:
    return [_Step(load, position), _Step(test, value, target)]


def _ports_match(ports: Sequence[PortRange], target: str) -> list[_Step]:
    steps = []
    for side in (0, 2):
        steps.append(_Step("ldh_x", _ETHERNET + side))
        for number, ports_range in enumerate(ports):
            after = f"{target}_{side}_{number}"
            steps += [
                _Step("jge", ports_range.first, "", after),
                _Step("jgt", ports_range.last, after, target),
                _label(after),
            ]
    return steps


def _follow(number: int) -> list[_Step]:
    little, zero, advance, inside = (f"{name}_{number}" for name in ("little", "zero", "advance", "inside"))
    have, skip, at_end = (f"{name}_{number}" for name in ("have", "skip", "end"))
    return [
        _Step("tax"),
        _Step("stx", _NEXT),
        _Step("add", 4),
        _Step("ldx_mem", _LENGTH),
        _Step("jgt_x", 0, at_end, inside),
        _label(inside),
        _Step("ldx_mem", _NEXT),
        _Step("stx", _HEADER),
        _Step("ldb_x", 0),
        _Step("st", _KIND),
        _Step("ldb_x", 1),
        _Step("jset", 1, little),
        _Step("ldh_x", 2),
        _Step("ja", if_true=have),
        _label(little),
        _Step("ldb_x", 3),
        _Step("lsh", 8),
        _Step("st", _HIGH_BYTE),
        _Step("ldb_x", 2),
        _Step("ldx_mem", _HIGH_BYTE),
        _Step("or_x"),
        _label(have),
        _Step("jeq", 0, zero, advance),
        _label(zero),
        # Length 0 means "up to the end of the packet", but for these two (DDSI-RTPS 2.5, 9.4.5.1.3).
        _Step("ld_mem", _KIND),
        _Step("jeq", _INFO_TS, skip),
        _Step("jeq", _PAD, skip),
        _label(at_end),
        _Step("ja", if_true="done"),
        _label(skip),
        _Step("ld_imm", 0),
        _label(advance),
        _Step("ldx_mem", _HEADER),
        _Step("add_x"),
        _Step("add", 4),
    ]


def _assemble(steps: Sequence[_Step]) -> bytes:
    targets: dict[str, int] = {}
    instructions: list[_Step] = []
    for step in steps:
        if step.operation:
            instructions.append(step)
        else:
            targets[step.label] = len(instructions)
    coded = []
    for number, step in enumerate(instructions):
        true_jump, false_jump = (targets[label] - number - 1 if label else 0 for label in (step.if_true, step.if_false))
        operand = step.operand
        if step.operation == "ja":  # the only jump that may be longer than 255 instructions
            operand, true_jump = true_jump, 0
        coded.append(struct.pack("=HBBI", _OPERATIONS[step.operation], true_jump, false_jump, operand))
    return b"".join(coded)

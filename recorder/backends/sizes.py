"""Sizes that a recording can choose, and the kind of call."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

from dds_trace.base.limits import Whole
from dds_trace.base.units import parse_size

from ..choices import Call, Role
from ..option import Axis, option


class Sizes(NamedTuple):
    buffer: int | None = None
    segment: int | None = None
    fragment: int | None = None


VENDORS_SIZES = Sizes()

ACTION_RESULT_BYTES = 33_000
LEAST_RESPONSE_BYTES = 64
"""A response has our whole stamp."""


def size_option(name: str, text: str, limit: Whole) -> int | None:
    parse = partial(parse_size, what=f"-o {name}")
    help_text = f"{text} ({', '.join(_WITH_SIZES[name])}). Default: the vendor's"
    axis = Axis(kind=int, unit="bytes", meaning=f'{text[0].lower()}{text[1:]}, as a number or a text such as `"4MB"`')
    return option(None, f"--{name} SIZE", help_text, limit=limit, parse=parse, axis=axis)


def call_option() -> Call:
    help_text = "What carries a message and its reply instead of two topics:"
    return option(Call.NONE, "--call KIND", help_text, roles=(Role.PING, Role.RELAY), axis=Axis())


def response_size_option(limit: Whole) -> int | None:
    help_text = "Size of the response to a call, for both sides. Default: as the request; of an action 33KB"
    axis, parse = Axis(kind=int, unit="bytes"), partial(parse_size, what="-o response_size")
    return option(
        None, "--response-size SIZE", help_text, roles=(Role.PING, Role.RELAY), limit=limit, parse=parse, axis=axis
    )


def text_bytes(text: str) -> int:
    return len(text) if text.isascii() else len(text.encode(errors="replace"))


def requested_bytes(call: Call, response_bytes: int | None) -> int | None:
    """Return the bytes of a response, None where it is as long as its request."""
    if call is Call.ACTION:  # its result has whole numbers of four bytes
        return 4 * max((response_bytes or ACTION_RESULT_BYTES) // 4, 1)
    return None if response_bytes is None else max(response_bytes, LEAST_RESPONSE_BYTES)


_WITH_SIZES = {
    "buffer": ("Fast DDS", "Cyclone DDS", "zenoh over TCP", "socket"),
    "segment": ("Fast DDS", "zenoh"),
    "fragment": ("UDP of Fast DDS, Cyclone DDS and socket", "zenoh"),
}

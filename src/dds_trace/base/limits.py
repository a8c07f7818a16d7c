"""One list of validators for options, plans and traces, so that what one refuses no other accepts.

A validator never raises: not for NaN, an integer of 400 digits, or text that no encoding has.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection
from dataclasses import dataclass
from typing import Protocol

from .errors import OptionError
from .printable import printable

_SHOWN_CHARACTERS = 80
_SHOWN_DIGITS = 20
_COMPARED_CHARACTERS = 100


class Limit(Protocol):
    def fault(self, value: object) -> str | None:
        """Return what to write instead of `value`, None if it is allowed."""


@dataclass(frozen=True, slots=True)
class Whole:
    """Whole numbers from `low` to `high`, inclusive; `what` is the noun for the error."""

    low: int
    high: int
    what: str

    def fault(self, value: object) -> str | None:
        if isinstance(value, int) and not isinstance(value, bool) and self.low <= value <= self.high:
            return None
        return f"{self.what} must be between {self.low} and {self.high}"


@dataclass(frozen=True, slots=True)
class Real:
    """Finite numbers from `low` to `high`, inclusive unless `is_above`; `what` is the noun with its unit for the error."""

    low: float
    high: float
    what: str
    is_above: bool = False

    def fault(self, value: object) -> str | None:
        if (
            isinstance(value, int | float)
            and not isinstance(value, bool)
            and self.low <= value <= self.high  # False for NaN; exact for an int of any size
            and not (self.is_above and value == self.low)
        ):
            return None
        low, high = f"{self.low:.15g}", f"{self.high:.15g}"
        bounds = f"above {low} and at most {high}" if self.is_above else f"between {low} and {high}"
        return f"{self.what} must be {bounds}"


@dataclass(frozen=True, slots=True)
class RealOrMax(Real):
    """As `Real`, or infinite, which is written `max`."""

    def fault(self, value: object) -> str | None:
        fault = Real.fault(self, value)
        return None if fault is None or value == math.inf else f"{fault}, or max"


@dataclass(frozen=True, slots=True)
class Words:
    """Texts that match `pattern` as a whole, with at most `most` characters; `what` is the noun and form for the error."""

    what: str
    pattern: re.Pattern[str] = re.compile(r".*", re.DOTALL)
    most: int = 4096

    def fault(self, value: object) -> str | None:
        if not isinstance(value, str):
            return f"{self.what} must be text"
        if not is_utf8(value):
            return f"{self.what} must be UTF-8 text; this is in another encoding, or half of a character"
        if len(value) > self.most:
            return f"{self.what} has at most {self.most} characters; this has {len(value)}"
        if "\0" in value or self.pattern.fullmatch(value) is None:
            return f"write {self.what}"
        return None


@dataclass(frozen=True, slots=True)
class OneOf:
    choices: tuple[str, ...] | tuple[float, ...]

    def fault(self, value: object) -> str | None:
        if not isinstance(value, bool) and value in self.choices:
            return None
        words = [f"{choice:g}" if isinstance(choice, float) else choice for choice in self.choices]
        return nearest(value if isinstance(value, str) else "", words)


@dataclass(frozen=True, slots=True)
class FilePath:
    """Paths that Linux and every library of an analysis can name; `what` is the noun for the error.

    A folder may also be `.`, `..` or `/`; an input may have bytes that are not UTF-8, in names that others gave.
    """

    what: str
    is_folder: bool = False
    is_input: bool = False

    def fault(self, value: object) -> str | None:
        if self.is_input and isinstance(value, str):
            value = value.encode(errors="replace").decode()  # undecodable bytes of a name are lone surrogates
        fault = Words(self.what, most=4095).fault(value)
        if fault is not None or not value:  # an empty path is the working folder, which nobody named
            return fault or f"write {self.what}"
        parts = str(value).rstrip("/").split("/")
        if not self.is_folder and parts[-1] in {"", ".", ".."}:
            return f"{self.what} ends with a name"
        longest = max(len(part.encode()) for part in parts)
        return f"{self.what} has names of at most 255 bytes; one has {longest}" if longest > 255 else None


@dataclass(frozen=True, slots=True)
class Flag:
    def fault(self, value: object) -> str | None:
        return None if isinstance(value, bool) else "write true or false"


def check(limit: Limit, value: object, where: str) -> None:
    """Raise an `OptionError` that begins with the option `where` if its value is refused; None passes, as not given."""
    fault = None if value is None else limit.fault(value)
    if fault is not None:
        raise OptionError(f"{where} {shown(value)}: {fault}")


def nearest(word: str, choices: Collection[str]) -> str:
    import difflib  # noqa: PLC0415 - only errors need it, and each command loads this module

    near = difflib.get_close_matches(word[:_COMPARED_CHARACTERS], choices, n=1)
    return f"did you mean {near[0]!r}?" if near else f"choose one of {', '.join(choices)}"


def shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        # str() refuses more than 4300 digits (`sys.set_int_max_str_digits`).
        digits = int(value.bit_length() * math.log10(2)) + 1
        return str(value) if digits <= _SHOWN_DIGITS else f"a number of about {digits} digits"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | dict):  # one may contain an integer that has no text
        return "a list" if isinstance(value, list) else "a table"
    return printable(repr(value), _SHOWN_CHARACTERS)


def is_utf8(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


YEAR_S = 366 * 86_400
LAST_DOMAIN = 232
"""Highest domain id with a port up to 65535: domain d starts at 7400 + 250 d (DDSI-RTPS 2.5, 9.6.2.3)."""
MAX_PAYLOAD_BYTES = 1 << 30
"""Largest payload: it is in memory while it is sent, and a small board has 2 GB."""
MAX_MESSAGES = 100_000_000
"""A run's ledger needs 20 bytes of memory for each."""

DOMAIN_ID = Whole(0, LAST_DOMAIN, "a DDS domain id")
RELAY_ID = Whole(1, (1 << 32) - 2, "a relay's id")
SIZE_BYTES = Whole(0, MAX_PAYLOAD_BYTES, "the size of a message in bytes")
RESPONSE_BYTES = Whole(1, MAX_PAYLOAD_BYTES, "the size of a response in bytes")
CLIENTS = Whole(1, 64, "the number of clients")
RATE_HZ = Real(1e-6, 1e6, "a rate in messages a second")
RATE_HZ_OR_MAX = RealOrMax(RATE_HZ.low, RATE_HZ.high, RATE_HZ.what)
PING_SHARE = Real(1e-6, 1, "the share of the messages that are sent back")
MESSAGES = Whole(1, MAX_MESSAGES, "the number of messages to measure")
MESSAGES_OR_NONE = Whole(0, MAX_MESSAGES, "the number of messages")
WARMUP = Whole(0, MAX_MESSAGES, "the number of warm-up messages")
RELAYS = Whole(1, 1000, "the number of relays to wait for")
NODES = Whole(0, 100, "the number of nodes")
RECORDERS = Whole(1, 64, "the number of relays, hosts, pings or topics")
DEPTH = Whole(1, (1 << 31) - 1, "the number of messages that keep_last keeps")
SEED = Whole(-(1 << 63), (1 << 64) - 1, "a seed")
WAKE_MS = Whole(0, 60_000, "a time in milliseconds")
BUFFER_BYTES = Whole(4096, 1 << 30, "the size of a buffer in bytes")
SEGMENT_BYTES = Whole(1 << 16, 1 << 32, "the size of a segment in bytes")
FRAGMENT_BYTES = Whole(1000, 65_000, "the size of a fragment in bytes")
PRIORITY = Whole(-(1 << 31), (1 << 31) - 1, "a priority of messages")
REALTIME_PRIORITY = Whole(1, 99, "a SCHED_FIFO priority")
PORT = Whole(1, 65535, "a port")
FILE_BYTES = Whole(1000, 1 << 50, "the size of a file in bytes")
RETAINED_FILES = Whole(1, 1_000_000, "the number of files to keep")
REPEATS = Whole(1, 10_000, "the number of repeats")
PASSES_OR_ALL = Whole(0, 10_000, "the number of repeats")
LOOKS = Whole(1, 10, "the number of looks")
ATTEMPTS = Whole(1, 1000, "the number of attempts")
KNEE_REPEATS = Whole(1, 1000, "the number of runs at the knee")

WAIT_S = Real(0, YEAR_S, "a wait in seconds")
LENGTH_S = Real(0, YEAR_S, "a length in seconds", is_above=True)
LENGTH_OR_NONE_S = Real(0, YEAR_S, "a length in seconds")
FILE_AGE_S = Real(1, YEAR_S, "the age of a file in seconds")
SEARCH_MINUTES = Real(2, 1440, "the time of a search in minutes")
LOOK_S = Real(0.1, YEAR_S, "the time between two checks in seconds")
DELAY_MS = Real(0, 3_600_000, "a time in milliseconds")
DEADLINE_MS = Real(0, 3_600_000, "a deadline in milliseconds", is_above=True)
LINE_MBIT_S = Real(0, 1e6, "a line rate in Mbit/s")
UNIX_S = Real(0, 1e11, "a time in seconds since 1970")
PERCENT = Real(0, 100, "a share in percent")
BURST = Real(0, 1e4, "a number of fragments")
WIDTH_PERCENT = Real(0, 1e6, "half the width of an interval in percent", is_above=True)
FACTOR = Real(1, 1000, "a factor", is_above=True)

FLAG = Flag()
TEXT = Words("a text")
NAME = Words("a name of one line", re.compile(r"[^\x00-\x1f\x7f]*"), 255)
LABEL_KEY = Words("a key of one line, without =", re.compile(r"[^\x00-\x1f\x7f=]+"), 255)
FILE_NAME = Words(
    "a name: not empty, no slash, no control character, not . or ..",
    re.compile(r"(?!\.{1,2}\Z)[^/\x00-\x1f\x7f]+"),
    100,
)
CONDITION = Words("a condition such as '< 20 ms'", re.compile(r"\s*(?:<=|<|>=|>)\s*\S[^\x00-\x1f]*"), 100)
PATH = FilePath("a path")
FOLDER = FilePath("a path", is_folder=True)
INPUT = FilePath("a path", is_folder=True, is_input=True)
SCHEDULER = Words(
    "HOST:PORT or tcp://HOST:PORT", re.compile(r"(?:[a-z]+://)?[\w.%\[\]-]+(?::[\w%]+)*:\d{1,5}", re.ASCII), 255
)
CPUS = Words(
    "CPU numbers and ranges, such as 3 or 0,2 or 2-3",
    re.compile(r"\s*\d{1,4}(?:-\d{1,4})?\s*(?:,\s*\d{1,4}(?:-\d{1,4})?\s*)*", re.ASCII),
)
RMW = Words("a ROS middleware's name such as rmw_fastrtps_cpp", re.compile(r"\w+", re.ASCII), 255)
ADDRESS = Words("HOST:PORT, for example 192.168.0.5:7447", re.compile(r"[\w.:%\[\]-]+:\d{1,5}", re.ASCII), 255)
HOST = Words("a host's name or address", re.compile(r"[\w.:%\[\]-]+", re.ASCII), 255)
FLOW_NAME = Words("a flow's name: letters, digits and _, such as imu", re.compile(r"[A-Za-z]\w*", re.ASCII), 40)
TOPIC_NAME = Words(
    "a ROS topic's name such as /camera/image", re.compile(r"/?[A-Za-z_]\w*(?:/[A-Za-z_]\w*)*/?", re.ASCII), 200
)
TOPIC_PATTERN = Words(
    "a topic's name such as /camera/image, or a pattern such as '/camera/*'", re.compile(r"[\w/.:*?$@~-]+"), 255
)

# Fields of traces: what the columns of an analysis can store, sums and differences of two included.
STORED_COUNT = Whole(0, (1 << 48) - 1, "a count")
STORED_BYTES = Whole(0, (1 << 32) - 1, "a size in bytes")
STORED_NUMBER = Whole(0, (1 << 31) - 1, "a number")
STORED_RELAY_ID = Whole(0, (1 << 32) - 1, "a relay's id")
STORED_TIME_NS = Whole(-(1 << 62), 1 << 62, "a time in ns")
STORED_RATE_HZ = Real(0, 1e12, "a rate in messages a second")
STORED_INTEGER = Whole(-(1 << 63), (1 << 64) - 1, "an integer")

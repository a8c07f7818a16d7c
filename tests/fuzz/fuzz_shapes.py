"""What the fuzz targets share: an input's first byte says what the others stand for, how bytes change a good value, and
that an error names the file.

No mutation finds its way through a CRC, a compressed frame or the braces of JSON by chance, so a target offers several
shapes: the bytes as they are, and the bytes as changes to something good.
"""

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

T = TypeVar("T")

HOSTILE_VALUES: tuple[object, ...] = (
    None,
    True,
    False,
    0,
    -1,
    1,
    2**31,
    2**32,
    2**63 - 1,
    2**63,
    -(2**63),
    2**64 - 1,
    2**64,
    10**400,
    0.5,
    -0.0,
    1e308,
    float("inf"),
    float("-inf"),
    float("nan"),
    "",
    "x",
    "ping",
    "relay",
    "\0",
    "\ud800",
    "<b>&\x1b[31m\n",
    "../../x",
    "-x",
    "ffffffffffffffff",
    "9" * 400,
    [],
    [[]],
    {},
    {"": None},
    {"depth": -1},
)
"""Values that a field of a description or a plan may have in a hostile file."""

RECORD = struct.Struct("<HB")


def shaped(shapes: Sequence[Callable[[bytes], T]], data: bytes) -> T:
    return shapes[data[0] % len(shapes)](data[1:]) if data else shapes[0](b"")


def shaped_seeds(shapes: Sequence[Callable[[bytes], object]], of_shapes: Mapping[Any, bytes]) -> dict[str, bytes]:
    return {shape.__name__.lstrip("_"): bytes([shapes.index(shape)]) + data for shape, data in of_shapes.items()}


def changed(good: bytes, data: bytes) -> bytes:
    """Return good bytes with others put into them: each three bytes of `data` are a place and a byte."""
    result = bytearray(good)
    for place, byte in RECORD.iter_unpack(data[: len(data) // RECORD.size * RECORD.size]):
        result[place % len(result)] = byte
    return bytes(result)


def changed_fields(good: Any, data: bytes) -> Any:
    """Return a copy of nested dicts and lists with `HOSTILE_VALUES` put into them.

    Each three bytes of `data` are the place of a value, counted depth first, and the number of the value that takes its
    place; the last number removes a key.
    """
    result = good
    for place, number in RECORD.iter_unpack(data[: len(data) // RECORD.size * RECORD.size]):
        places = list(_places(result))
        if not places:
            return result
        target = places[place % len(places)]
        result = _replaced(result, target, number % (len(HOSTILE_VALUES) + 1))
    return result


def must_name(name: object, err: Exception) -> None:
    if str(name) not in str(err):
        raise AssertionError(f"the error does not name the file: {err}") from err


def _places(value: Any, above: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    keys = value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    return [path for key in keys for path in [(*above, key), *_places(value[key], (*above, key))]]


def _replaced(value: Any, path: tuple[Any, ...], number: int) -> Any:
    key, *rest = path
    copy = value.copy()
    if rest:
        copy[key] = _replaced(copy[key], tuple(rest), number)
    elif number == len(HOSTILE_VALUES):
        del copy[key]
    else:
        copy[key] = HOSTILE_VALUES[number]
    return copy

"""Every fuzz target meets inputs of a fixed seed, about a second each in `just test-all`; `just fuzz` draws them by the hour."""

import random

import pytest
from fuzz import TARGETS, open_target

INPUTS = {
    "reader": 250,
    "descriptions": 16,
    "plan": 300,
    "bag": 60,
    "bag1": 300,
    "logs": 100,
    "limits": 300,
    "state": 500,
    "ring": 500,
    "watch": 3000,
    "peers": 400,
    "strangers": 400,
}
"""Inputs of each target; `just test` takes a tenth."""

BYTES = (0, 1, 2, 3, 4, 8, 0x7F, 0x80, 0xFF)
LONGEST = 12_000


def mutated(data, others, draw):
    """`data` with a few bytes changed, left out, doubled, or taken from another seed."""
    result = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 4, 16))):
        at = draw.randrange(len(result) + 1)
        length = draw.choice((1, 2, 4, 8, 64))
        other = draw.choice(others)
        begin = draw.randrange(len(other))
        result[at : at + draw.choice((0, length))] = draw.choice(
            (
                bytes([draw.choice(BYTES)]) * length,
                draw.randbytes(length),
                b"",
                result[at : at + length] * 2,
                other[begin : begin + length],
            )
        )
    return bytes(result[:LONGEST])


@pytest.mark.parametrize("share", [0.1, pytest.param(1.0, marks=pytest.mark.thorough)])
@pytest.mark.parametrize("name", TARGETS)
def test_inputs_of_a_fixed_seed(name, share, tmp_path):
    target, draw = open_target(name, tmp_path), random.Random(f"fuzz {name}")
    seeds = list(target.seeds().values())
    for data in seeds:
        target.try_input(data)
    for number in range(round(share * INPUTS[name])):
        data = mutated(draw.choice(seeds), seeds, draw)
        try:
            target.try_input(data)
        except Exception as err:
            raise AssertionError(f"input {number} of {name}: {data!r}") from err

"""Colours of neighbouring parts stay apart: as they are, for the three colour blindnesses and in grey, on both grounds.

Colour blindness as Machado, Oliveira and Fernandes (2009) simulate it at full severity, in linear light; differences as
CIE76 in CIELAB under D65, the plain distance.
"""

import re
from importlib.resources import files
from itertools import combinations

import numpy as np
import pytest

from dds_trace.reports.html.styles import PALETTE

CSS = (files("dds_trace.reports.html") / "assets" / "page.css").read_text(encoding="utf-8")
LEAST = 15.0
LEAST_CONTRAST = 3.0  # of a mark on its ground (WCAG 1.4.11)

SEEN_AS = {
    "all cones": np.eye(3),
    "protanopia": np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]),
    "deuteranopia": np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]),
    "tritanopia": np.array([[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]),
    "print in grey": np.array([[0.2126, 0.7152, 0.0722]] * 3),
}  # fmt: skip
# Which parts touch in `breakdown` (late send, there, relay, back) and in `wire_cost` (data, again, control, discovery).
NEIGHBOURS = (("a", "b"), ("b", "c"), ("c", "d"), ("a", "c"))


def linear(colour):
    channels = np.array([int(colour[place : place + 2], 16) for place in (1, 3, 5)]) / 255
    return np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)


def lab(light):
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    ratio = to_xyz @ np.clip(light, 0, 1) / np.array([0.95047, 1.0, 1.08883])
    f = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def apart(one, other, eyes):
    return float(np.linalg.norm(lab(SEEN_AS[eyes] @ linear(one)) - lab(SEEN_AS[eyes] @ linear(other))))


def contrast(one, other):
    low, high = sorted(float(np.array([0.2126, 0.7152, 0.0722]) @ linear(colour)) for colour in (one, other))
    return (high + 0.05) / (low + 0.05)


def tokens(theme):
    block = re.search(
        {"light": r":root \{(.*?)\}", "dark": r':root\[data-theme="dark"\] \{(.*?)\}'}[theme], CSS, re.DOTALL
    )
    return dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", block[1]))


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("eyes", SEEN_AS)
def test_neighbouring_parts_can_be_told_apart(theme, eyes):
    colours = tokens(theme)
    for one, other in NEIGHBOURS:
        assert apart(colours[f"part-{one}"], colours[f"part-{other}"], eyes) >= LEAST, (one, other)


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_every_part_and_line_stands_out_from_its_ground(theme):
    colours = tokens(theme)
    drawn = [colours[f"part-{part}"] for part in "abcd"] + [pair[theme == "dark"] for pair in PALETTE]
    assert min(contrast(colour, colours["ground"]) for colour in drawn) >= LEAST_CONTRAST


def test_the_simulation_is_the_papers():
    """Red and green of one lightness lie apart for all cones, and nearly together without the long or the middle ones."""
    red, green = "#c23b22", "#3f7d20"
    assert apart(red, green, "all cones") > 80
    assert apart(red, green, "deuteranopia") < apart(red, green, "all cones") / 2
    assert [round(value) for value in lab(linear("#ffffff"))] == [100, 0, 0]


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_three_middlewares_are_told_apart_by_colour_alone(theme):
    for eyes in ("all cones", "protanopia", "deuteranopia", "tritanopia"):
        for one, other in combinations(PALETTE[:2], 2):
            assert apart(one[theme == "dark"], other[theme == "dark"], eyes) >= LEAST

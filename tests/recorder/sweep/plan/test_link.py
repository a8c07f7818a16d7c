from __future__ import annotations

from dds_trace.recorder.sweep.plan.link import PRESETS, Link


def test_presets_are_those_that_are_documented():
    assert set(PRESETS) == {"ethernet-1g", "ethernet-100m", "wifi-54", "wifi-poor", "5g"}


def test_link_in_words(sentences):
    sentences(str(PRESETS["wifi-poor"]), str(Link()))

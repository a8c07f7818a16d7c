from __future__ import annotations

import pytest
from pinned import PINNED, assert_pinned


@pytest.mark.parametrize("name", PINNED["statistics"])
def test_every_statistic_says_of_drawn_campaigns_what_it_said(name):
    assert_pinned("statistics", name)


@pytest.mark.parametrize("name", PINNED["series"])
def test_every_detector_says_of_drawn_series_what_it_said(name):
    assert_pinned("series", name)

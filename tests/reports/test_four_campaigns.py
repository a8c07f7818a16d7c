"""The campaigns that the page is judged on are what they say they are."""

import pytest
from four_campaigns import CAMPAIGNS

from dds_trace.analyzer.verdicts.answers import Clarity
from dds_trace.reports.notebook import MOST_CHARACTERS

SHAPES = {
    # name -> groups, devices and links, runs of each group, whether messages are lost
    "demo": (6, 1, 3, False),
    "lossy machine": (126, 1, 3, True),
    "study": (384, 6, 3, True),
    "500 groups": (520, 1, 1, True),
}


@pytest.mark.parametrize("name", CAMPAIGNS)
def test_a_campaign_has_its_groups_places_runs_and_losses(name):
    analysis = CAMPAIGNS[name]()
    summary = analysis.summary
    places = summary.select("ping_device", "relay_device", "connectivity").unique().height
    loses = bool((summary["received"] < summary["published"]).any())
    (runs,) = summary["runs"].unique()
    assert (summary.height, places, runs, loses) == SHAPES[name]
    assert len(analysis.runs) == summary["runs"].sum()
    first = analysis._repr_html_()
    assert len(first) <= MOST_CHARACTERS
    assert ("color:#e5484d" in first) == SHAPES[name][3], "losses are red in a notebook, too"
    assert first.count("<tbody>") == places


def test_three_runs_allow_verdicts_in_the_study_and_the_radio_is_where_it_loses():
    analysis = CAMPAIGNS["study"]()
    assert {answer.fewest_runs for answer in analysis.details.answers} == {3}
    assert {Clarity.CLEAR, Clarity.INCONCLUSIVE} == {answer.clarity for answer in analysis.details.answers}
    lost = analysis.summary.filter(analysis.summary["received"] < analysis.summary["published"])
    assert set(lost["connectivity"]) == {"wireless"}
    assert lost["payload_bytes"].min() > 145_000

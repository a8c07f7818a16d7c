from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.model.finding import Finding, Severity
from dds_trace.analyzer.saving.records import from_json, to_json
from dds_trace.analyzer.verdicts.job import Job
from dds_trace.analyzer.verdicts.recommend import Candidate, Fit, Recommendation

JOB = Job("binary", 33_000, 10.0, 50, 0.9)
TEXTS = st.text(max_size=5)
FLOATS = st.none() | st.floats(allow_nan=False)


def through_json(record):
    return from_json(type(record), json.loads(json.dumps(to_json(record), allow_nan=False)))


@given(
    st.builds(
        Candidate,
        setting=st.dictionaries(TEXTS, TEXTS | st.integers() | st.none(), max_size=3),
        fit=st.sampled_from(Fit),
        measured=st.booleans(),
        value_ns=FLOATS,
        metric=TEXTS,
        latency_ns=FLOATS,
        lower_ns=FLOATS,
        upper_ns=FLOATS,
        margin_ns=FLOATS,
        messages=st.integers(),
        held_out=st.integers(),
        tied=st.booleans(),
        reason=TEXTS,
    )
)
def test_a_record_comes_back_equal(candidate):
    recommendation = Recommendation(JOB, (candidate,))
    assert through_json(recommendation) == recommendation


def test_not_a_number_comes_back():
    assert math.isnan(through_json(Job("binary", 1, math.nan, 1, 0.5)).rate_hz)


def test_a_whole_number_in_the_place_of_a_float_stays_whole():
    assert repr(through_json(Job("binary", 1, 10, 1, 0.5)).rate_hz) == "10"


FINDING = Finding(Severity.INFO, "code", "where", "what", "action", (1, 2))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"severity": "bad"}, "Finding.severity: 'bad' is not a valid Severity"),
        ({"code": 5}, "Finding.code is 5"),
        ({"groups": [1, "2"]}, "Finding.groups is '2'"),
        ({"groups": 1}, "Finding.groups is 1"),
        ({"count": True}, "Finding.count is True"),
    ],
)
def test_another_type_is_refused(change, words):
    assert from_json(Finding, to_json(FINDING)) == FINDING
    with pytest.raises(ValueError, match=words):
        from_json(Finding, {**to_json(FINDING), **change})


def test_a_missing_field_is_refused():
    with pytest.raises(ValueError, match="Finding lacks severity"):
        from_json(Finding, {})
    with pytest.raises(ValueError, match="Finding is None"):
        from_json(Finding, None)

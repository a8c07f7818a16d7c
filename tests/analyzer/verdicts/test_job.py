"""The grammar of a job, and what its errors advise."""

from __future__ import annotations

import pytest
from roundtrip_frames import MS

from dds_trace.analyzer.verdicts.job import Job, parse_job
from dds_trace.base.errors import OptionError


def test_the_grammar():
    assert parse_job("data=binary size=502KB rate=20 deadline=50ms reliability=0.999") == Job(
        "binary",
        502_000,
        20.0,
        50 * MS,
        0.999,
    )
    assert parse_job(
        "domain=different reliability=99.9% deadline=0.5s rate=2.5Hz size=1KiB data=string"
    ) == Job(
        "string",
        1024,
        2.5,
        500 * MS,
        pytest.approx(0.999),
        "different",
    )
    assert parse_job("data=imu rate=100 deadline=5ms reliability=0.9").payload_bytes == 296


def test_the_line_of_the_readme_runs():
    assert parse_job("data=binary size=502KB rate=20 deadline=50ms").reliability == 0.99


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("dat=binary", "did you mean 'data'"),
        ("data=binary data=string", "given twice"),
        ("data=binary size", "size has no value; write size=502KB"),
        ("data=binary size=big rate=20 deadline=50ms reliability=0.9", "size=big is not understood"),
        ("data=binary size=1KB rate=0 deadline=50ms reliability=0.9", "rate=0 is not understood"),
        ("data=binary size=1KB rate=20 deadline=50 reliability=0.9", "deadline=50 is not understood"),
        ("data=binary size=1KB rate=20 deadline=50ms reliability=1", "reliability=1 is not understood"),
        ("data=binary size=1KB rate=20 deadline=50ms reliability=0.9 domain=5", "domain=5"),
        ("data=binary size=1KB", "rate, deadline missing; add rate=20"),
        ("", "missing"),
    ],
)
def test_errors_say_what_to_write(text, words):
    with pytest.raises(OptionError, match=words):
        parse_job(text)

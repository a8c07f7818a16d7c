import pytest
from roundtrip_frames import MS

from dds_trace.analyzer.verdicts.job import Job, make_job
from dds_trace.base.errors import OptionError


def test_the_grammar():
    assert make_job(data="binary", size="502KB", rate="20", deadline="50ms", reliability="0.999") == Job(
        "binary", 502_000, 20.0, 50 * MS, 0.999
    )
    assert make_job(
        domain="different", reliability="99.9%", deadline="0.5s", rate="2.5Hz", size="1KiB", data="string"
    ) == Job("string", 1024, 2.5, 500 * MS, pytest.approx(0.999), "different")
    assert make_job(size="502KB", rate="20", deadline="50ms").reliability == 0.99


@pytest.mark.parametrize(
    ("name", "value"),
    [("size", "big"), ("rate", "0"), ("deadline", "50"), ("reliability", "1"), ("domain", "5"), ("metric", "x")],
)
def test_errors_say_what_to_write(name, value):
    with pytest.raises(OptionError, match=f"{name} '{value}' is not understood"):
        make_job(**{"size": "1KB", "rate": "20", "deadline": "50ms", name: value})

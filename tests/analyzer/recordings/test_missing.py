import pytest
from shaped_bags import shapes, write_shape

from dds_trace.analyzer.recordings.topics import analyze_topics

SHAPES = shapes()


@pytest.mark.parametrize("name", SHAPES)
def test_known_deletions_come_back(tmp_path, name):
    shape = SHAPES[name]
    deleted = write_shape(tmp_path / "x.mcap", shape)
    report = analyze_topics(tmp_path / "x.mcap")
    row = report.topics.filter(topic="/topic").row(0, named=True)
    if not shape.is_known:
        assert (row["missing"], row["missing_low"], row["missing_from"]) == (None, None, "")
        return
    assert row["missing"] == pytest.approx(deleted, abs=max(0.01 * len(shape.sent_ms), 1))
    assert row["missing_low"] <= deleted <= row["missing_high"]
    assert sum(report.holes.filter(topic="/topic")["missing"]) <= row["missing"] + 0.01 * len(shape.sent_ms)

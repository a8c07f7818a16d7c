from campaigns import write_runs

from dds_trace import analyze
from dds_trace.reports.book.book import Book


def test_every_run_has_its_beginning_and_what_came_back(tmp_path):
    write_runs(tmp_path, [1, 2])
    analysis = analyze(tmp_path)
    runs = Book(analysis).run_times
    assert [(run.run_id, run.group) for run in runs] == [(8, 0), (9, 0)]
    rows = analysis.load_roundtrips()
    for run in runs:
        own = rows.filter(run_id=run.run_id)
        assert (run.published, run.received) == (own.height, own.filter(outcome="completed").height)
        assert run.origin_ns == own["scheduled_ns"].fill_null(own["publish_ns"]).min()
        assert run.last_ns == own["publish_ns"].max()
        assert run.p50_ns == round(own["latency_ns"].median())
        assert run.max_ns == own["latency_ns"].max()

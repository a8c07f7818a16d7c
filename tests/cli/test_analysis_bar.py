from pathlib import Path

from trace_files import TWELVE, write_pair

from dds_trace import analyze
from dds_trace.analyzer.pipeline import STEPS
from dds_trace.cli.analysis import SHARES, AnalysisBar


def test_every_step_after_reading_moves_the_bar_on(tmp_path):
    write_pair(tmp_path / "runs", TWELVE)
    seen = []
    with AnalysisBar() as bar:

        def step(name, share):
            bar.step(name, share)
            seen.append((name, bar.share))

        analyze(tmp_path / "runs", progress=bar.reading, step=step)
        assert [name for name, _ in seen] == ["pairing", "judging"]
        assert [share for _, share in seen] == [SHARES["reading"], SHARES["reading"] + SHARES["pairing"]]
        bar.reading(0, 2, Path("late.mcap"))
        assert bar.share == seen[-1][1]
    assert list(SHARES) == ["reading", *STEPS]
    assert round(sum(SHARES.values()), 9) == 1

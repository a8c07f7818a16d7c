"""What a terminal of 80 columns or a log has of a sweep."""

import io

from rich.console import Console

from dds_trace.extensions.campaigns.run.progress import PlainProgress


def lines_of(*steps):
    out = io.StringIO()
    progress = PlainProgress(Console(file=out, width=80))
    progress.begin(24, 0)
    for name, outcome, complete in steps:
        progress.ended(name, outcome, complete=complete)
    return out.getvalue().splitlines()


LONG = "ros2-cyclonedds_builtin-zenoh_binary-33KB_10Hz_r2"
REASON = "failed: no echo within 20 s; looked for: a relay of binary_image in domain 5, through the bridge builtin"


def test_a_result_takes_no_more_than_80_columns_and_keeps_its_words():
    outcome = "RTT p50 101 p99 347 ms, 18/20 messages, 10 % lost"
    lines = lines_of((LONG, outcome, True), (LONG, REASON, False))
    assert max(map(len, lines)) <= 80
    assert lines[0].startswith("[1/24] ")
    assert " ".join(" ".join(lines).split()) == f"[1/24] {LONG}: {outcome} [1/24] {LONG}: {REASON}"


def test_a_reason_is_said_once():
    lines = lines_of(("a", REASON, False), ("a", REASON, False), ("b", "failed: killed", False))
    assert [line.split()[1:4] for line in lines[-2:]] == [["a:", "failed", "for"], ["b:", "failed:", "killed"]]

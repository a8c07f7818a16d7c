import math

import pytest
from sweep_desk import LAST_LOST, MESSAGES, TIMELINE, write_ping

from dds_trace.extensions.campaigns.run.result import read_cpu_percent, read_responses


@pytest.mark.parametrize(
    ("timeline", "published", "expected"),
    [
        (TIMELINE, MESSAGES, [0.2, 0.3, 0.4, 0.5]),
        (LAST_LOST, MESSAGES, [0.2, 0.3, 0.4, math.inf]),
        (TIMELINE, 2, [0.2, 0.3, math.inf, math.inf]),
    ],
)
def test_a_lost_and_an_unsent_message_never_come_back_and_the_warm_up_does_not_count(
    tmp_path, timeline, published, expected
):
    write_ping(tmp_path / "a.ping.mcap", 7, published=published, timeline=timeline)
    assert sorted(read_responses(tmp_path / "a.ping.mcap")) == pytest.approx(expected)
    assert read_cpu_percent(tmp_path / "a.ping.mcap") == 0

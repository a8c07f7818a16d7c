"""`limits.toml`: which gate judges which result, what is refused, and limits written from good runs."""

import polars as pl
import pytest
from roundtrip_frames import MS, in_runs

from dds_trace.base.errors import OptionError
from dds_trace.extensions.gates.compare import CompareOptions, compare_roundtrips
from dds_trace.extensions.gates.gates import judge_gates, options_for
from dds_trace.extensions.gates.limits_file import limits_text, read_limits

LIMITS = """
[thresholds]
latency_p50 = ["< 20 ms", "< +10 %"]
received_ratio = "> 99 %"
[thresholds."payload_bytes=2*"]
latency_p50 = "< +50 %"
[thresholds."/camera/*"]
age_p99 = "< 50 ms"
[[accepted]]
result = "payload_bytes=3000"
latency_p50 = "< +70 %"
reason = "checksums"
commit = "1a2b3c4"
"""


def side(milliseconds, spread=1e-3):
    return pl.concat(
        in_runs([round(ms * MS)] * 40, spread=spread, run_id=number, payload_bytes=1000 * number)
        for number, ms in enumerate(milliseconds, start=1)
    )


def judged(path, text, base, new):
    path.write_text(text)
    gates = read_limits(path)
    return judge_gates(
        compare_roundtrips(base, new, options_for(gates, CompareOptions(metrics=(), statistics=()))), gates
    )


def test_the_last_limit_that_fits_a_result_judges_it(tmp_path):
    results = judged(tmp_path / "limits.toml", LIMITS, side([5, 5, 5, 15]), side([6, 6, 6, 30]))
    changes = {
        r.subject.partition("payload_bytes=")[2][:4]: r for r in results if r.gate.text.startswith("latency_p50 < +")
    }
    assert {size: (r.gate.text, r.outcome.value) for size, r in changes.items()} == {
        "1000": ("latency_p50 < +10 %", "regressed"),
        "2000": ("latency_p50 < +50 %", "passed"),
        "3000": ("latency_p50 < +70 %", "passed"),
        "4000": ("latency_p50 < +10 %", "regressed"),
    }
    assert changes["3000"].gate.accepted == "checksums (1a2b3c4)"
    values = [r.outcome.value for r in results if r.gate.text == "latency_p50 < 20 ms"]
    assert values == ["passed", "passed", "passed", "regressed"]
    assert sum(r.gate.metric == "received_ratio" for r in results) == 4


def test_limits_by_result_are_one_family(tmp_path):
    """A table for each of forty results alarms as seldom as one limit of all."""
    tables = "".join(
        f'[thresholds."payload_bytes={size}"]\nlatency_p50 = "< +1 %"\n' for size in range(1000, 41_000, 1000)
    )
    base, new = side([5] * 40, 0.03), side([5.5] + [5] * 39, 0.03)
    alone = judged(tmp_path / "limits.toml", tables, base.filter(payload_bytes=1000), new.filter(payload_bytes=1000))
    among = judged(tmp_path / "limits.toml", tables, base, new)
    assert (alone[0].outcome.value, among[0].outcome.value) == ("regressed", "inconclusive")


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("latency_p50 = '< 5 ms'", "thresholds"),
        ("[thresholds]\nlatncy_p50 = '< 5 ms'", "latency_p50"),
        ("[thresholds]\nlatency_p50 = 5", "condition"),
        ("[thresholds.'Binary 33 KB']\nlatency_p50 = '< 5 ms'", "COLUMN=PATTERN"),
        ("[thresholds.'payload=3']\nlatency_p50 = '< 5 ms'", "payload_bytes"),
        ("[thresholds.'rate_hz=3'.'rate_hz=3']\nlatency_p50 = '< 5 ms'", "within"),
        ("[thresholds]\nage_p99 = '< 5 ms'", "a result has"),
        ("[[accepted]]\nlatency_p50 = '< +40 %'\nreason = 'known'", "commit"),
        ("\u0000", "limits.toml"),
    ],
)
def test_what_is_not_a_limit_is_refused_in_one_line(tmp_path, text, word):
    path = tmp_path / "limits.toml"
    path.write_text(text)
    with pytest.raises(OptionError, match=word) as error:
        read_limits(path)
    assert "\n" not in str(error.value)
    for other in (tmp_path, "/dev/zero", tmp_path / "missing"):
        with pytest.raises(OptionError, match="--limits"):
            read_limits(type(path)(other))


@pytest.mark.parametrize(("factor", "outcome"), [(1.02, "passed"), (2, "regressed")])
def test_written_limits_pass_runs_like_the_good_ones_and_fail_slower_ones(tmp_path, factor, outcome):
    good, new = (in_runs([round(5 * MS * times)] * 400, runs=5, spread=0.02) for times in (1, factor))
    text = limits_text(compare_roundtrips(good, good, CompareOptions(metrics=("latency",), statistics=("p50",))))
    results = judged(tmp_path / "limits.toml", text, good, new)
    assert [r.outcome.value for r in results] == [outcome, outcome, "passed"]

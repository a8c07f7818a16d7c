import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from roundtrip_frames import MS

from dds_trace.analyzer.verdicts.job import Job, guess_time, make_job
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


SIZES = (10_000, 100_000, 1_000_000)
RATES = (10.0, 20.0, 40.0)


def grid(law):
    return {(size, rate): law(size, rate) for size in SIZES for rate in RATES}


@given(exponent=st.floats(-1, 2), slope=st.floats(-1, 2), size=st.floats(10_000, 1_000_000), rate=st.floats(10, 40))
@settings(deadline=None)
def test_a_power_law_comes_back_exactly(exponent, slope, size, rate):
    law = lambda s, r: 1000 * s**exponent * r**slope  # noqa: E731 - one formula, used twice
    guess = guess_time(grid(law), (size, rate))
    assert guess.value_ns == pytest.approx(law(size, rate), rel=1e-6)
    assert guess.error_factor == pytest.approx(1.0, abs=1e-6)
    # The middle of the grid, and the middles of its four sides.
    assert guess.held_out == 5


def test_a_step_shows_in_the_error():
    # Flat at 1 ms up to 100 KB, 100 ms at 1 MB: between them anything may be true.
    cells = {(size, rate): (1e6 if size < 1_000_000 else 1e8) for size in SIZES for rate in RATES}
    guess = guess_time(cells, (300_000, 20.0))
    assert guess.error_factor == pytest.approx(10.0)  # 100 KB from its neighbours: 10 ms, is 1 ms
    assert guess.lower_ns <= 1e6 * 10 ** (2 * 0.477)
    assert guess.upper_ns == pytest.approx(guess.value_ns * 10)


def test_along_one_axis():
    cells = {(size, 10.0): size * 10.0 for size in (1000, 2000, 4000, 8000, 16000)}
    guess = guess_time(cells, (3000, 10.0))
    assert guess.value_ns == pytest.approx(30_000)
    assert guess.held_out == 3


@pytest.mark.parametrize("cell", [(5000, 20.0), (2_000_000, 20.0), (100_000, 5.0), (100_000, 80.0)])
def test_nothing_is_guessed_outside(cell):
    assert guess_time(grid(lambda s, r: s * r), cell) is None


def test_too_few_cells_to_hold_out():
    assert guess_time({(1000, 10.0): 1.0, (2000, 10.0): 2.0, (4000, 10.0): 4.0}, (3000, 10.0)) is None
    assert guess_time({}, (3000, 10.0)) is None

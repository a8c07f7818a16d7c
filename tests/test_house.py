import importlib.util
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
SPEC = importlib.util.spec_from_file_location("house", ROOT / "scripts" / "house.py")
house = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(house)

BARS = tomllib.loads(house.BARS.read_text())


@pytest.fixture(scope="module")
def rooms():
    return house.count_rooms()[0]


@pytest.fixture(scope="module")
def product(rooms):
    return sum(rooms.values(), Counter())


@pytest.fixture(scope="module")
def counts(rooms, product):
    return house.count_house(product, sum(rooms[room]["lines"] for room in house.MAIN_HOUSE))


def git(*arguments):
    try:
        ran = subprocess.run(["git", "-C", ROOT, *arguments], capture_output=True, text=True, check=False)
    except FileNotFoundError:
        pytest.skip("no git here")
    return ran.stdout if ran.returncode == 0 else None


@pytest.mark.parametrize("commit", ["HEAD", "HEAD^"])
def test_no_bar_is_above_the_parent_commits(commit):
    text = git("show", f"{commit}:scripts/house.toml")
    if text is None:
        pytest.skip(f"no bars of {commit} here: an archive, a clone without history, or the first commit with bars")
    assert house.raised_bars(tomllib.loads(text), BARS) == []


def test_each_count_is_within_its_bar_and_each_bar_is_lowered(counts):
    assert set(BARS["bars"]) == set(BARS["room"]) == set(counts)
    assert house.missed_bars(counts, BARS["bars"]) == []
    assert house.stale_bars(counts, BARS) == []


def test_a_first_backend_has_room(product):
    toy, _ = house.count_module(ROOT / "tests/support/toy_backend.py")
    table = Counter(lines=1)  # of BACKEND_MODULES
    assert house.missed_bars(house.count_house(product + toy + table), BARS["bars"]) == []


TEXT = """
[bars]
lines = 1000
share = 2.0
[room]
lines = 300
share = 0.1
[allowances]
"It grows" = { lines = 500 }
"It gives back" = { lines = -500 }
"""


def bars_of(text):
    return tomllib.loads(text)["bars"]


def test_lowering_writes_the_count_and_the_room():
    lowered = house.lower({"lines": 600, "share": 1.5}, TEXT)
    assert bars_of(lowered) == {"lines": 900, "share": 1.6}
    assert house.stale_bars({"lines": 600, "share": 1.5}, tomllib.loads(TEXT))[0].startswith("lines: 1,000")
    assert house.stale_bars({"lines": 600, "share": 1.5}, tomllib.loads(lowered)) == []


def test_lowering_raises_nothing():
    assert house.lower({"lines": 900, "share": 2.5}, TEXT) == TEXT


@pytest.mark.parametrize(("count", "bar", "rest"), [(800, 1100, 400), (1400, 1500, 0), (500, 800, 500)])
def test_an_allowance_is_taken_as_far_as_its_issue_grows(count, bar, rest):
    text = house.lower({"lines": count, "share": 2.0}, TEXT, "It grows")
    assert bars_of(text)["lines"] == bar
    assert tomllib.loads(text)["allowances"]["It grows"]["lines"] == rest
    assert house.raised_bars(tomllib.loads(TEXT), tomllib.loads(text)) == []


def test_a_promise_gives_nothing():
    assert bars_of(house.lower({"lines": 800, "share": 2.0}, TEXT, "It gives back"))["lines"] == 1000


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("lines = 1000", "lines = 1001"), "lines: from 1,000 to 1,001, allowed 0 more"),
        (("share = 2.0", "share = 2.1"), "share: from 2.0 to 2.1"),
        (("lines = -500", "lines = -900"), None),
        (("lines = 500 }", "lines = 900 }"), None),
    ],
)
def test_a_raised_bar_is_named(change, said):
    raised = house.raised_bars(tomllib.loads(TEXT), tomllib.loads(TEXT.replace(*change, 1)))
    assert (raised[0].startswith(said) and len(raised) == 1) if said else raised == []


def test_a_raise_needs_an_allowance_of_the_parent():
    text = TEXT.replace("lines = 1000", "lines = 1100") + '"New" = { lines = 100 }\n'
    assert house.raised_bars(tomllib.loads(TEXT), tomllib.loads(text))


@pytest.mark.parametrize("name", ["held", "_held", "of_rows", "kept_rows", "one"])
def test_a_vague_name(name):
    assert house.is_vague(name)
    assert not house.is_vague("withheld_rows")


def test_words_of_docstrings_comments_and_strings_are_counted(tmp_path):
    path = tmp_path / "module.py"
    path.write_text('"""A file whose rows lie behind it."""\n# told\nTEXT = "beside"\ntold: int = 3  # told: a field\n')
    count, lines = house.count_module(path)
    assert (count["bad"], count["read"], count["vague"]) == (3, 1, 1)
    assert lines == [(1, "whose"), (1, "behind"), (2, "told"), (3, "beside"), (4, "told")]

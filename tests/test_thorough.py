"""Of a dear test `just test` runs some cases, `just test-all` all of them."""

import pytest
from thorough import mark_thorough


class Case:
    """What pytest's items have of it."""

    def __init__(self, nodeid, keeps, *, is_slow=False):
        self.nodeid, self.marks = nodeid, []
        self._marks = {"keeps": keeps and pytest.mark.keeps(keeps).mark, "slow": is_slow and pytest.mark.slow.mark}

    def get_closest_marker(self, name):
        return self._marks[name] or None

    def add_marker(self, name):
        self.marks.append(name)


@pytest.mark.parametrize(
    ("cases", "keeps", "kept"),
    [(1, 1, [0]), (5, 1, [0]), (6, 2, [0, 3]), (7, 3, [0, 2, 4]), (3, 9, [0, 1, 2]), (4, None, [0, 1, 2, 3])],
)
def test_a_test_keeps_its_first_case_and_others_spread_over_it(cases, keeps, kept):
    items = [Case(f"a.py::test[{place}]", keeps) for place in range(cases)]
    other, slow = Case("a.py::test_other", 1), Case("a.py::test[slow]", keeps, is_slow=True)
    mark_thorough([slow, *items, other])
    assert [place for place, item in enumerate(items) if "thorough" not in item.marks] == kept
    assert other.marks == slow.marks == []


@pytest.mark.parametrize(("names", "kept"), [(["demo", "study-a", "500 groups"], [0]), (["study", "500 groups"], [0])])
def test_a_large_page_is_thorough_where_there_is_a_smaller_one(names, kept):
    items = [Case(f"a.py::test[{name}]", None) for name in names]
    mark_thorough(items)
    assert [place for place, item in enumerate(items) if "thorough" not in item.marks] == kept

"""What `just test` leaves to `just test-all`: of a dear test's cases all but a few, which are spread over them."""

from collections import defaultdict
from collections.abc import Iterable

import pytest


def mark_thorough(items: Iterable[pytest.Item]) -> None:
    """Of each test that is marked `keeps(n)`, leave n cases, the first among them; mark the others `thorough`."""
    cases: dict[str, list[pytest.Item]] = defaultdict(list)
    for item in items:
        if item.get_closest_marker("keeps") and not item.get_closest_marker("slow"):
            cases[item.nodeid.partition("[")[0]].append(item)
    for of_test in cases.values():
        (keeps,) = of_test[0].get_closest_marker("keeps").args
        places = {place * len(of_test) // keeps for place in range(keeps)}
        for place, item in enumerate(of_test):
            if place not in places:
                item.add_marker("thorough")

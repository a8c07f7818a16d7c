"""What `just test` leaves to `just test-all`: of a dear test's cases all but a few, which are spread over them, and large pages."""

from collections import defaultdict
from collections.abc import Iterable

import pytest

LARGE = ("study", "500 groups")
"""Analyses whose pages take seconds: a test that has smaller ones, too, is thorough with these."""


def mark_thorough(items: Iterable[pytest.Item]) -> None:
    """Of each test that is marked `keeps(n)`, leave n cases, the first among them, and of others all but large pages; mark the rest."""
    cases: dict[str, list[pytest.Item]] = defaultdict(list)
    for item in items:
        if not item.get_closest_marker("slow"):
            cases[item.nodeid.partition("[")[0]].append(item)
    for of_test in cases.values():
        if marker := of_test[0].get_closest_marker("keeps"):
            places = {place * len(of_test) // marker.args[0] for place in range(marker.args[0])}
        else:
            names = [item.nodeid.partition("[")[2] for item in of_test]
            places = {place for place, name in enumerate(names) if not any(large in name for large in LARGE)} or {0}
        for place, item in enumerate(of_test):
            if place not in places:
                item.add_marker("thorough")

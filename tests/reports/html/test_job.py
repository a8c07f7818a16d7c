"""The form "Does it fit my job?": it agrees with the recommendation of the analyzer, and guesses nothing."""

from __future__ import annotations

import pytest
from four_campaigns import CAMPAIGNS

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]


def ask(tab, **fields):
    """Fill in the form; the answer, the fits of the table and the commands."""
    for name, value in fields.items():
        field = tab.locator(f"#job-form [name={name}]")
        if field.evaluate("e => e.tagName") == "SELECT":
            field.select_option(value)
        else:
            field.fill(value)
    rows = tab.locator("#job-table tbody tr")
    fits = [rows.nth(row).locator("th, td").nth(1).inner_text() for row in range(rows.count())]
    return tab.locator("#job-answer").inner_text(), fits, tab.locator("#job-command code").text_content()


def cell_of(name):
    """The message with most results of a campaign: data, size, rate."""
    summary = CAMPAIGNS[name]().summary
    count = summary.group_by("data_type", "payload_bytes", "rate_hz").len().sort("len", "payload_bytes").tail(1)
    return count.row(0)[:3]


def test_what_was_measured_is_ranked_by_the_deadline(reader, pages):
    tab = reader.open(pages("demo"))
    _, size, rate = cell_of("demo")
    answer, fits, _ = ask(tab, size=f"{size} B", rate=f"{rate:g} Hz", deadline="1 s", share="p90")
    assert "meets" in fits or "likely" in fits
    assert "meet it" in answer or "meets it" in answer or "likely" in answer
    answer, fits, commands = ask(tab, deadline="1 ns")
    assert set(fits) <= {"misses", "unclear", "not known"}
    assert ("Everything" in answer) is (set(fits) == {"misses"})
    if set(fits) == {"misses"}:
        assert commands == ""
    assert reader.complaints == []


def test_what_was_not_measured_is_not_known_and_a_command_would_decide(reader, pages):
    tab = reader.open(pages("demo"))
    answer, fits, commands = ask(tab, size="12345 B", rate="7 Hz")
    assert answer.startswith("Not known")
    assert fits == []
    relay, ping = commands.splitlines()
    assert relay.startswith("dds-record --role relay --backend ")
    assert "--size 12345 --rate 7 --messages " in ping
    answer, _, commands = ask(tab, size="large")
    assert (answer.split()[1], commands) == ("size", "")


def test_too_few_messages_for_the_share_are_not_known(reader, pages):
    tab = reader.open(pages("demo"))
    _, size, rate = cell_of("demo")
    _, fits, commands = ask(tab, size=f"{size} B", rate=f"{rate:g} Hz", share="p99_9", deadline="1 s")
    assert set(fits) == {"not known"}
    assert "--messages 3" in commands  # for 99.9 % 3,688

import re
import shlex
from dataclasses import replace
from html import unescape

import polars as pl
import pytest
from analyses import MS, Measured, make_analysis
from roundtrip_frames import in_runs, steady
from wording import numbers

from dds_trace.analyzer.verdicts.job import Guess, Job
from dds_trace.cli import trace
from dds_trace.cli.record.command import words_of_role
from dds_trace.extensions.campaigns.recommend import recommend_settings
from dds_trace.extensions.campaigns.recommendation import PING_OPTIONS, SETTING_OPTIONS, recommendation_info
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Role
from dds_trace.recorder.option import options_of
from dds_trace.recorder.option_table import is_setting, key_of
from dds_trace.recorder.options import PingOptions, RecordOptions
from dds_trace.reports.book.book import Book
from dds_trace.reports.book.groups import VENDORS, VendorLabels
from dds_trace.reports.html.page import render as render_html
from dds_trace.reports.markdown import render as render_markdown
from dds_trace.reports.terminal import render as render_terminal

JOB = Job("binary", 33_000, 10.0, 50 * MS, 0.99, metric="latency")
MIXED = [MS + (n * 37 % 101) * 1000 for n in range(1500)]
WITH_LOSSES = pl.concat([in_runs(MIXED), in_runs([None, MS] * 500, vendor="zenoh", run_id=2, spread=0.0)])


def advised(frame):
    return recommendation_info(recommend_settings(frame, JOB), VendorLabels(VENDORS))


def book_of(frame, job=JOB):
    analysis = make_analysis(Measured([MS, MS]))
    return Book(replace(analysis, details=replace(analysis.details, recommendation=recommend_settings(frame, job))))


def test_the_job_has_its_deadline_and_what_meets_it(sentences):
    advice = advised(WITH_LOSSES)
    assert advice.sentence.startswith("Fast DDS meets")
    assert numbers(advice.sentence) == [50, 3, 73]
    sentences(advice.job, advice.sentence)
    good, lossy = advice.rows
    assert good[1] == "meets"
    assert "; 3 runs, " in good[2]
    assert " bursts" in good[2]
    assert lossy[1] == "misses"
    assert numbers(lossy[2])[:2] == [50, 1]  # no interval from lost to lost


def test_one_run_is_not_said_to_meet_it_nor_are_short_ones_and_the_commands_record_what_is_needed():
    advice = advised(steady(4 * MIXED))
    assert advice.sentence.endswith("likely to meet it: Fast DDS.")
    assert "within one run" in advice.rows[0][2]
    short = advised(in_runs(MIXED[:50], runs=5))
    assert "5 runs, too short" in short.rows[0][2]
    needed, present = numbers(short.rows[0][2].partition("to prove")[2])[1:]
    assert (present, 5 * taken(short.commands[1][1]).ping.messages >= max(needed, 500)) == (250, True)


def test_settings_are_told_in_words_by_what_sets_them_apart():
    apart = {"domain_mode": "different", "relay_domain_id": 10, "bridge": "builtin"}
    frame = pl.concat(
        [
            in_runs(MIXED),
            in_runs(MIXED, vendor="zenoh", relay_vendor="zenoh", run_id=2),
            in_runs(MIXED, run_id=3, setting="tuned=true", **apart),
        ]
    )
    assert {tuple(row[0].split(", ")) for row in advised(frame).rows} == {
        ("Fast DDS", "same domain"),
        ("Zenoh", "same domain"),
        ("Fast DDS", "through our built-in bridge", "tuned"),
    }


def test_each_pair_of_devices_and_link_has_a_recommendation_of_its_own(sentences):
    # What is best on the laptop says nothing about the Pi, which is ten times as slow.
    slow = [10 * ns for ns in MIXED]
    frame = pl.concat(
        [
            in_runs(MIXED, ping_device="laptop", relay_device="laptop"),
            in_runs(slow, run_id=2),
            in_runs(slow, run_id=3, setting="flows=2", vendor="zenoh", relay_vendor="zenoh"),
            in_runs([100 * ns for ns in MIXED], run_id=4, connectivity="wireless"),
        ]
    )
    advice = advised(frame)
    sentences(advice.sentence)
    assert advice.rows[0][0] == "Fast DDS, on laptop, wired"
    slow, link = [100 * ns for ns in MIXED], "link=slow(queue_ms=100,rate_mbit_s=1)"
    both = advised(pl.concat([in_runs(slow, setting=link), in_runs(slow, run_id=9, vendor="zenoh", setting=link)]))
    assert (both.sentence.count("Mbit/s"), [row for row in both.rows if "Mbit/s" in row[2]]) == (1, [])


def test_the_terminal_has_a_numbered_line_for_each_setup():
    book = book_of(WITH_LOSSES, replace(JOB, metric="response"))
    alone, whole = render_terminal(book), render_terminal(Book(book.analysis, shows_all=True))
    assert whole.endswith(alone)
    words = " ".join(alone.split())
    assert "from planned send to reply" in words
    assert "vendor=" not in alone
    assert " 1. ✓ Fast DDS" in alone
    assert " 2. ✗ Zenoh" in alone
    assert "received 50 %" in words
    assert "To decide" not in alone


def taken(command):
    program, *words = shlex.split(command)
    options = []
    trace.build(words)(words_of_role(words), obj=options.append, standalone_mode=False)
    assert program == "dds-trace"
    return options[0]


def test_the_commands_that_would_decide_are_whole_and_taken_as_they_stand():
    setup = {
        "vendor": "cyclonedds",
        "backend": "cyclonedds",
        "rmw": None,
        "bridge": "builtin",
        "domain_mode": "different",
    }
    more = {
        "relay_domain_id": 10,
        "reliability": "best_effort",
        "depth": 3,
        "relay_vendor": "fastdds",
        "relay_backend": "ros2",
    }
    setting = "cpu_load=50%25,deadline_ns=20000000,relay.rmw=rmw_fastrtps_cpp,relay.transport=udp,tuned=true"
    advice = advised(steady(MIXED[:200], **setup, **more, setting=setting))
    (relay_device, relay), (ping_device, ping) = advice.commands
    assert (relay_device, ping_device) == ("relay-pi", "ping-pi")
    there, here = taken(relay), taken(ping)
    assert (there.backend, there.node.rmw, there.node.transport.value, there.ping) == (
        "ros2",
        "rmw_fastrtps_cpp",
        "udp",
        None,
    )
    assert (here.backend, here.node.transport.value, here.ping.bridge) == ("cyclonedds", "default", "builtin")
    sent = here.ping
    assert (sent.data, sent.size_bytes, sent.rate_hz, sent.settings) == ("binary", 33_000, 10.0, {"cpu_load": "50%"})
    assert sent.messages >= 100
    for side, device in ((there, "relay-pi"), (here, "ping-pi")):
        assert (side.node.tuned, side.node.qos.reliability, side.node.qos.depth) == (True, "best_effort", 3)
        assert side.node.qos.extra == {"deadline_ns": 20_000_000}
        assert (side.device, side.connectivity) == (device, "wired")


def test_on_one_machine_and_of_a_bag_the_command_says_so():
    place = {"ping_device": "vm", "relay_device": "vm", "connectivity": "loopback"}
    setting = "CYCLONEDDS_URI=my file.xml#0123abcd,data=bag:drive#/imu"
    commands = [command for _, command in advised(steady(MIXED, **place, setting=setting)).commands]
    assert all(command.startswith("CYCLONEDDS_URI='my file.xml' dds-trace record ") for command in commands)
    relay, ping = (taken(command.partition("' ")[2]) for command in commands)
    assert {side.node.discovery.value for side in (relay, ping)} == {"localhost"}
    assert (ping.ping.data, ping.ping.size_bytes) == ("bag:drive#/imu", None)


def test_every_setting_of_a_recording_has_its_option_in_the_commands():
    rows = {
        name: f"-o {key_of(row)}" if is_setting(row, Role.PING) else row.name
        for record in (PingOptions, RecordOptions, NodeOptions)
        for name, row in options_of(record).items()
        if row.in_key
    }
    own = {"settings": "-o setting", **SETTING_OPTIONS, **PING_OPTIONS}
    assert {name: own.get(name) for name in rows} == rows


def test_it_stands_on_top_and_its_commands_in_the_page_in_markdown_and_in_the_terminal():
    book = book_of(steady(MIXED))
    page, markdown = re.sub("</?span>", "", unescape(render_html(book))), render_markdown(book)
    for text in (page, markdown, render_terminal(book).replace(" \\\n      ", " ")):
        for device, command in book.advice.commands:
            assert f"on {device}:" in text
            assert command in text
    read = page.replace("\N{NO-BREAK SPACE}", " ")
    for text, first_below in ((read, 'id="figures"'), (markdown, "What was measured")):
        assert text.index("within the deadline of 50 ms") < text.index(first_below)
    assert markdown.index(book.advice.sentence) < markdown.index(book.answer.headline[:10])
    analysis = replace(book.analysis, details=replace(book.analysis.details, recommendation=None))
    assert Book(analysis).advice_blocks() == []


@pytest.mark.parametrize("device", ["d" * length for length in range(1, 12)])
def test_a_command_of_the_terminal_is_broken_between_words_only(device):
    book = book_of(steady(MIXED, ping_device=device))
    text = render_terminal(book)
    assert max(map(len, text.splitlines())) <= 80
    assert all(command in text.replace(" \\\n      ", " ") for _, command in book.advice.commands)


def test_the_commands_record_as_many_runs_as_are_said_to_decide():
    advice = advised(in_runs([50 * ns for ns in MIXED[:400]], runs=4, spread=0.3))
    (runs,) = numbers(advice.rows[0][2].partition("interval; ")[2])
    assert numbers(advice.missing)[0] == runs > 4


def test_a_guess_is_said_to_be_one_with_the_share_of_its_interval():
    job, guess = replace(JOB, payload_bytes=30_000, deadline_ns=2000 * MS), Guess("learned", 3 * MS, 2 * MS, 6 * MS, 34)
    ranking = recommend_settings(steady(MIXED), job, estimate=lambda *_: guess)
    (row,) = recommendation_info(ranking, VendorLabels(VENDORS)).rows
    assert "a guess" in row[2]
    assert "90 %: 2 ms to 6" in row[2]
    assert "95 %" not in row[2]
    assert row[1] == "likely"

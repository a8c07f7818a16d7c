"""The figure of one message to several relays, from a frame drawn by hand."""

from dataclasses import replace

import polars as pl
from analyses import MS, Measured, make_analysis

from dds_trace.analyzer.groups.fan_out import FAN_OUT_SCHEMA
from dds_trace.reports.book.book import Book
from dds_trace.reports.figures.fan_out import Receivers, fan_out_figure, fan_out_info
from dds_trace.reports.figures.figure import Figure, LeftOut


def drawn(*rows):
    analysis = make_analysis(*(Measured([MS], setting=f"hosts={n},relays={n},tuned=true") for n in (2, 5)))
    frame = pl.DataFrame([dict.fromkeys(FAN_OUT_SCHEMA) | row for row in rows], FAN_OUT_SCHEMA)
    return fan_out_info(Book(replace(analysis, details=replace(analysis.details, fan_out=frame))))


def row(group, receivers, **times):
    named = {f"{name}_p50_ns": time_ns for name, time_ns in times.items()}
    return {"group": group, "receivers": receivers, "senders": 1, **named}


def test_results_that_differ_only_in_the_number_are_one_line():
    info = drawn(row(1, 5, first_receiver=MS, last_receiver=4 * MS), row(0, 2, first_receiver=MS, last_receiver=2 * MS))
    ((name, points),) = info.lines.items()
    assert name.endswith("tuned=true")
    assert points == (Receivers(0, 2, MS, 2 * MS, None), Receivers(1, 5, MS, 4 * MS, None))
    assert isinstance(fan_out_figure(info), Figure)
    assert info.of == "Relays"


def test_with_one_relay_the_pings_are_counted():
    assert drawn(row(0, 1), row(1, 1)).of == "Pings"


def test_without_rows_there_is_none():
    assert isinstance(fan_out_figure(drawn()), LeftOut)

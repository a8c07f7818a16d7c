"""The numbers of docs/results/replayed-link.md are those of its rows."""

import csv
from pathlib import Path

RESULTS = Path(__file__).parents[2] / "docs" / "results"
SETUPS = {"Cyclone DDS": "cyclonedds", "zenoh": "zenoh"}


def rows():
    return list(csv.DictReader((RESULTS / "replayed-link.csv").read_text().splitlines()))


def test_each_median_and_count_is_that_of_the_rows():
    lines = (RESULTS / "replayed-link.md").read_text().splitlines()
    table = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if "0 Hz |" in line]
    assert len(table) == 4
    for setup, data, *medians, received in table:
        for load, shown in zip(("none", "cpu"), medians, strict=True):
            own = [
                row
                for row in rows()
                if (row["backend"], row["load"]) == (SETUPS[setup], load) and (row["data"] == "imu") is ("IMU" in data)
            ]
            ordered = sorted(own, key=lambda row: row["repeat"])
            assert [float(text) for text in shown.split(",")] == [float(row["rtt_p50_ms"]) for row in ordered]
            assert f"{sum(int(row['replies']) for row in own):,}" in received
            assert f"{sum(int(row['sent']) for row in own):,}" in received


def test_frames_are_late_by_less_than_a_hundredth_of_the_least_delay():
    late_us = [float(row["late_p50_us"]) for row in rows()]
    page = (RESULTS / "replayed-link.md").read_text()
    assert len(late_us) == 24
    assert f"{max(late_us):g} us in the worst run" in page
    assert max(late_us) < 0.01 * 18_100
    assert (
        f"{sum(int(row['frames']) for row in rows()):,}, and {sum(int(row['frames_lost']) for row in rows()):,}" in page
    )

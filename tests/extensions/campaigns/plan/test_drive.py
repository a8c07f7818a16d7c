from pathlib import Path

import pytest

from dds_trace.base.errors import OptionError
from dds_trace.extensions.campaigns.plan.link import COLUMNS, read_drive
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan, read_plan

PLANS = Path(__file__).parents[4] / "plans"
SECOND = 1_000_000_000
HEAD = ",".join(COLUMNS)


def written(folder, text, name="drive.csv"):
    path = folder / name
    path.write_text(text)
    return str(path)


def test_rows_are_read_whatever_the_order_of_the_columns(tmp_path):
    drive = read_drive(written(tmp_path, "# walk\n\ndelay_ms, time_s\n5, 0\n7.5, 1.5\n"))
    assert drive.rows == ((0, 0, 5, 0, 0), (1.5, 0, 7.5, 0, 0))
    assert (drive.has_rate, drive.length_s) == (False, 1.5)


def test_the_hash_is_of_the_file(tmp_path):
    one, other = (read_drive(written(tmp_path, f"{HEAD}\n0,1,{d},0,0\n1,1,5,0,0\n", f"{d}.csv")) for d in (5, 6))
    assert one.sha256 != other.sha256
    assert one.has_rate


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "first line"),
        ("time_s\n0\n1\n", "first line"),
        ("time_s,speed\n0,1\n", "speed"),
        ("time_s,delay_ms,delay_ms\n0,1,1\n", "first line"),
        (f"{HEAD}\n0,1,5,0,0\n", "1 row"),
        (f"{HEAD}\n1,1,5,0,0\n2,1,5,0,0\n", "at time_s 0"),
        (f"{HEAD}\n0,1,5,0,0\n0,1,5,0,0\n", "drive.csv:3"),
        (f"{HEAD}\n0,1,5,0\n1,1,5,0,0\n", "4 values for 5"),
        (f"{HEAD}\n0,fast,5,0,0\n1,1,5,0,0\n", "rate_mbit_s"),
        (f"{HEAD}\n0,nan,5,0,0\n1,1,5,0,0\n", "rate_mbit_s"),
        (f"{HEAD}\n0,1,5,101,0\n1,1,5,0,0\n", "loss_percent"),
        (f"{HEAD}\n0,1,-5,0,0\n1,1,5,0,0\n", "delay_ms"),
    ],
)
def test_a_wrong_file_is_one_line_that_names_it(tmp_path, text, said):
    with pytest.raises(OptionError) as raised:
        read_drive(written(tmp_path, text))
    assert "drive.csv" in str(raised.value)
    assert said in str(raised.value)
    assert "\n" not in str(raised.value)


def test_a_missing_file_and_one_that_is_not_text(tmp_path):
    with pytest.raises(OptionError, match=r"none\.csv"):
        read_drive(str(tmp_path / "none.csv"))
    (tmp_path / "picture.csv").write_bytes(b"\xff\xd8")
    with pytest.raises(OptionError, match=r"picture\.csv"):
        read_drive(str(tmp_path / "picture.csv"))


def test_changes_of_a_run_begin_with_what_is_valid_and_start_over(tmp_path):
    drive = read_drive(written(tmp_path, "time_s,delay_ms\n0,10\n1,20\n2,10\n"))
    during = list(drive.between(100 * SECOND, 101 * SECOND + 5, 103 * SECOND + 5))
    assert [(at_ns, row[2]) for at_ns, row in during] == [
        (101 * SECOND + 5, 20),
        (102 * SECOND, 10),
        (103 * SECOND, 20),
    ]
    within_a_row = list(drive.between(100 * SECOND, 100 * SECOND + 5, 100 * SECOND + 9))
    assert [(at_ns, row[2]) for at_ns, row in within_a_row] == [(100 * SECOND + 5, 10)]


def plan_with(folder, keys):
    return parse_plan(f"[axes]\nrate = 10\n[link]\n{keys}\n", "plan", str(folder / "plan.toml"))


def test_the_path_is_from_the_folder_of_the_plan_and_the_content_is_in_the_setting(tmp_path):
    written(tmp_path, "time_s,delay_ms\n0,10\n1,20\n")
    plan = plan_with(tmp_path, 'file = "drive.csv"')
    assert (plan.link.name, plan.connectivity, plan.namespaces) == ("drive", "emulated-drive", True)
    assert f"file=drive.csv#{plan.link.drive.sha256[:8]}" in plan.link.setting
    assert str(tmp_path) not in str(plan.link.to_dict())
    assert plan.link.to_dict()["sha256"] == plan.link.drive.sha256


def test_another_content_is_another_sweep(tmp_path):
    digests = set()
    for number in (1, 2):
        written(tmp_path, f"time_s,delay_ms\n0,{number}\n1,20\n", f"{number}.csv")
        digests.add(plan_with(tmp_path, f'name = "same"\nfile = "{number}.csv"').digest)
    assert len(digests) == 2


@pytest.mark.parametrize("key", ["delay_ms = 5", 'preset = "5g"', "rate_mbit_s = 1", "loss_percent = 1"])
def test_what_the_file_has_is_not_given_twice(tmp_path, key):
    written(tmp_path, "time_s,delay_ms\n0,10\n1,20\n")
    with pytest.raises(OptionError, match=key.split()[0]):
        plan_with(tmp_path, f'file = "drive.csv"\n{key}')


def test_nothing_of_another_file_is_printed(tmp_path):
    with pytest.raises(OptionError) as raised:
        read_drive(written(tmp_path, "root:secret:1\n"))
    assert "secret" not in str(raised.value)


def test_the_drive_of_the_repository_can_be_read():
    plan = read_plan(PLANS / "drive.toml")
    assert (plan.link.drive.length_s, len(plan.link.drive.rows)) == (60, 121)
    assert {cell.load for cell in plan.cells} == {"none", "cpu"}

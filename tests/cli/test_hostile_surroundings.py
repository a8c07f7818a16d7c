import pytest
from commands import run_main

OUTPUTS = (
    *("roundtrips.parquet", "summary.parquet", "report.html", "report.md", "report.json"),
    *("roundtrips.csv", "summary.csv", "roundtrips.arrow", "summary.arrow"),
    *("latency.derived.mcap", "latency.derived.foxglove.json"),
)


@pytest.fixture
def targets(tmp_path):
    folder = tmp_path / "targets"
    folder.mkdir()
    for name in (*OUTPUTS, "report.xml"):
        (folder / name).write_text("mine")
    return folder


def test_no_output_is_written_through_a_link(runs, tmp_path, targets):
    out = tmp_path / "out"
    out.mkdir()
    (out / "foreign").mkdir()
    for name in OUTPUTS:
        (out / name).symlink_to(targets / name)
    kinds = [word for kind in ("html", "md", "json") for word in ("--report", kind)]
    assert run_main(runs, "--out", out, *kinds, "--export", "csv", "--export", "arrow", "--derived-mcap") == 0
    assert {path.read_text() for path in targets.iterdir()} == {"mine"}
    assert sorted(path.name for path in out.iterdir()) == sorted((*OUTPUTS, "foreign"))
    assert not any(path.is_symlink() for path in out.iterdir())


def test_the_report_of_a_comparison_is_not_written_through_a_link_nor_half(runs, tmp_path, targets, capsys):
    report = tmp_path / "report.xml"
    report.symlink_to(targets / "report.xml")
    both = ("compare", runs, runs, "--report", "junit", "--report", "md", "--out", report, "--out")
    assert run_main(*both, tmp_path / "report.md") == 0
    assert (targets / "report.xml").read_text() == "mine"
    assert "<testsuite" in report.read_text()
    capsys.readouterr()
    files = sorted(tmp_path.iterdir())
    for path in ("/proc/gone/report.md", targets / "report.xml/report.md"):
        assert run_main(*both, path) == 6
        said = capsys.readouterr().err
        assert (str(path) in said, said.count("\n")) == (True, 1)
    assert sorted(tmp_path.iterdir()) == files, "no drafts"
    assert run_main(*both[:-1]) == 2
    assert "one file for each" in capsys.readouterr().err


def test_a_link_in_the_place_of_the_default_folder_is_refused(runs, targets, capsys):
    (runs / "analysis").symlink_to(targets)
    assert run_main(runs, "--report", "html") == 6
    assert "is a link to" in capsys.readouterr().err
    assert {path.read_text() for path in targets.iterdir()} == {"mine"}
    assert run_main(runs, "--report", "html", "--out", targets) == 0

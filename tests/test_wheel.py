import os
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from pathlib import Path

import pytest
from processes import executed

ROOT = Path(__file__).parents[1]
ROOMS = ("analyzer", "base", "cli", "extensions", "recorder", "reports", "tracefile")
LISTED = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "src/dds_trace/base", *ROOMS]


def built(folder, target, ending):
    build = [sys.executable, "-m", "hatchling", "build", "--target", target, "--directory", str(folder)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    (archive,) = folder.glob(f"*{ending}")
    return archive


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    return built(tmp_path_factory.mktemp("dist"), "wheel", ".whl")


@pytest.fixture(scope="module")
def source_archive(tmp_path_factory):
    return built(tmp_path_factory.mktemp("sdist"), "sdist", ".tar.gz")


@pytest.fixture(scope="module")
def environment(wheel, tmp_path_factory):
    """A new environment that holds the wheel; its dependencies are those of the environment that runs the tests."""
    folder = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    install = ["uv", "pip", "install", "--quiet", "--offline", "--no-deps", "--python", folder / "bin/python", wheel]
    subprocess.run(install, check=True)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    # Paths from a .pth file come last, and .pth files in them are not read: our editable install stays out.
    site.joinpath("dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder


@pytest.fixture
def hostile(tmp_path):
    """A folder with a package and one with a module for each room's name; importing one ends the process."""
    end = "raise SystemExit('imported ' + __name__)\n"
    for room in ROOMS:
        package = tmp_path / "packages" / room
        package.mkdir(parents=True)
        package.joinpath("__init__.py").write_text(end)
        tmp_path.joinpath("modules").mkdir(exist_ok=True)
        tmp_path.joinpath("modules", f"{room}.py").write_text(end)
    return f"{tmp_path / 'packages'}{os.pathsep}{tmp_path / 'modules'}"


def test_the_wheel_holds_one_import_name_and_every_file_of_the_rooms(wheel):
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert {name.split("/")[0] for name in names} == {"dds_trace"}
    ours = subprocess.run(LISTED, cwd=ROOT, check=True, capture_output=True, text=True)
    expected = {f"dds_trace/{name.removeprefix('src/dds_trace/')}" for name in ours.stdout.split()}
    assert names == expected | {"dds_trace/__init__.py", "dds_trace/__main__.py", "dds_trace/py.typed"}


def test_a_wheel_built_from_the_source_archive_is_the_one_built_from_the_repository(wheel, source_archive, tmp_path):
    # pip and `uv build` make a wheel from the archive, not from a clone.
    with tarfile.open(source_archive) as archive:
        archive.extractall(tmp_path, filter="data")
    (unpacked,) = tmp_path.iterdir()
    build = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(tmp_path)]
    subprocess.run(build, cwd=unpacked, check=True, capture_output=True)
    (built,) = tmp_path.glob("*.whl")
    assert {each.filename: each.CRC for each in zipfile.ZipFile(built).infolist()} == {
        each.filename: each.CRC for each in zipfile.ZipFile(wheel).infolist()
    }


@pytest.mark.parametrize(
    "command",
    [
        ["dds-record", "--help"],
        ["dds-trace", "doctor"],
        ["dds-trace", "sweep", "--help"],
        ["dds-analyze", str(ROOT / "sample_traces" / "same_domain"), "--report", "html", "--report", "md"],
    ],
    ids=lambda command: " ".join(command[:2]) if command[1].startswith("-") else command[0],
)
def test_commands_run_among_packages_with_the_names_of_our_rooms(environment, hostile, command, tmp_path):
    out = ["--out", str(tmp_path / "out")] if command[0] == "dds-analyze" else []
    words = [environment / "bin" / command[0], *command[1:], *out]
    done = executed(words, {"PYTHONPATH": hostile}, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    if out:
        assert {path.name for path in (tmp_path / "out").glob("*.*")} >= {"report.html", "report.md", "summary.parquet"}


def test_a_bridge_that_runs_as_a_module_is_started_among_them_too(environment, hostile, tmp_path):
    words = [environment / "bin/python", "-m", "dds_trace.extensions.bridges.builtin", tmp_path / "missing"]
    done = executed(words, {"PYTHONPATH": hostile}, cwd=tmp_path)
    assert "imported" not in done.stderr
    assert "missing" in done.stderr


def test_the_package_comes_from_the_wheel(environment, tmp_path):
    program = "import dds_trace.tracefile as room; print(room.__file__)"
    shown = subprocess.run(
        [environment / "bin/python", "-c", program], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    assert Path(shown.stdout.strip()).is_relative_to(environment)

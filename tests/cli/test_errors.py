import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import zstandard
from processes import executed

from dds_trace.base.errors import BackendUnavailableError, OptionError, OutputError, TraceFormatError
from dds_trace.cli.program import run_command
from dds_trace.recorder.errors import NoEchoError


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (OptionError("bad"), 2),
        (TraceFormatError("x.mcap", "bad", 7), 3),
        (OutputError("bad"), 6),
        (NoEchoError("bad"), 8),
    ],
)
def test_errors_have_a_line_and_an_exit_code(error, status, capsys, monkeypatch):
    def fail():
        raise error

    monkeypatch.setattr("sys.argv", ["/usr/bin/dds-record"])
    with pytest.raises(SystemExit) as ended:
        run_command(fail)
    assert ended.value.code == status
    assert capsys.readouterr().err == f"dds-record: {error}\n"


def test_our_own_mistakes_keep_their_traceback():
    def fail():
        raise KeyError("ours")

    with pytest.raises(KeyError):
        run_command(fail)


SAMPLES = Path(__file__).parents[2] / "sample_traces/same_domain"
WITHOUT = """
import sys
sys.modules[sys.argv.pop(1)] = None  # as if it were not installed
from dds_trace.cli.{module} import main
main()
"""


@pytest.mark.parametrize(
    ("package", "extra", "arguments"),
    [
        ("polars", "analyze", ()),
        ("pyarrow", "analyze", ()),
        ("jinja2", "analyze", ("--report", "html")),
        ("distributed", "cluster", ("--cluster", "tcp://127.0.0.1:1")),
    ],
)
def test_one_line_says_what_to_install(package, extra, arguments, tmp_path):
    ran = executed(
        [sys.executable, "-c", WITHOUT.format(module="dds_analyze"), package, SAMPLES, "--out", tmp_path, *arguments]
    )
    assert ran.returncode == BackendUnavailableError.exit_code
    (line,) = ran.stderr.splitlines()
    assert f"pip install 'dds-trace[{extra}]'" in line


def test_a_package_that_belongs_to_no_extra_is_a_fault_of_the_installation():
    command = [sys.executable, "-c", WITHOUT.format(module="dds_analyze"), "mcap", SAMPLES]
    ran = subprocess.run(command, check=False, capture_output=True, text=True)
    assert ran.stderr.splitlines()[-1].startswith("ModuleNotFoundError")


STOPPED = """
import sys, time
from pathlib import Path
from dds_trace.analyzer.loading.spool import TemporaryFolder
from dds_trace.cli.program import run_command
from dds_trace.tracefile.reading.storage import unpacked

def command():
    folder = TemporaryFolder()
    with unpacked(Path(sys.argv[1])) as path:
        print(path.stat().st_size, folder.path.is_dir(), flush=True)
        time.sleep(600)

run_command(command)
"""


def test_sigterm_leaves_no_temporary_file(tmp_path):
    packed, temporary = tmp_path / "bag.mcap.zstd", tmp_path / "temporary"
    packed.write_bytes(zstandard.compress(bytes(5000)))
    temporary.mkdir()
    command = subprocess.Popen(
        [sys.executable, "-c", STOPPED, str(packed)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=os.environ | {"TMPDIR": str(temporary)},
    )
    assert command.stdout.readline() == b"5000 True\n"
    assert len(list(temporary.iterdir())) == 2
    command.terminate()
    _, errors = command.communicate(timeout=60)
    assert (command.returncode, errors) == (128 + signal.SIGTERM, b"")
    assert not list(temporary.iterdir())

from __future__ import annotations

import pytest

from dds_trace.base.errors import OptionError, OutputError, TraceFormatError
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

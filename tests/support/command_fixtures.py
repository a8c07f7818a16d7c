"""How tests call commands in this process."""

import sys

import pytest
from trace_files import TWELVE, write_pair

from dds_trace.cli import trace


@pytest.fixture
def call(monkeypatch, capsys):
    def calling(*arguments, command="sweep"):
        monkeypatch.setattr(sys, "argv", ["dds-trace", command, *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            trace.main()
        said = capsys.readouterr()
        return ended.value.code or 0, said.out, said.err

    return calling


@pytest.fixture
def runs(tmp_path):
    write_pair(tmp_path / "runs", TWELVE)
    return tmp_path / "runs"

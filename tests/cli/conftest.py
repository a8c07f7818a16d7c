"""How tests call commands in this process."""

import sys

import pytest
from trace_files import TWELVE, write_pair

from dds_trace.cli.sweep import command


@pytest.fixture
def call(monkeypatch, capsys):
    def calling(*arguments):
        monkeypatch.setattr(sys, "argv", ["dds-sweep", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            command.main()
        said = capsys.readouterr()
        return ended.value.code or 0, said.out, said.err

    return calling


@pytest.fixture
def runs(tmp_path):
    write_pair(tmp_path / "runs", TWELVE)
    return tmp_path / "runs"

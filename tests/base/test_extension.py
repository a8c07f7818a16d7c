"""The door of `extensions/`: an extension is a package and a row."""

import sys
from types import ModuleType

import pytest

from dds_trace import extensions
from dds_trace.base.errors import OptionError
from dds_trace.base.extension import Extension, load, offers
from dds_trace.cli import trace
from dds_trace.cli.program import command, make_app

app = make_app()


@command(app, "toy")
def toy_command() -> None:
    """Say that the toy ran."""
    print("the toy ran")


@pytest.fixture
def toy(monkeypatch):
    """An extension `toy` whose home `command` is this module."""
    home = ModuleType("dds_trace.extensions.toy.command")
    home.app = app
    row = Extension(name="toy", commands={"toy": "command:app"})
    monkeypatch.setattr(extensions, "EXTENSIONS", (*extensions.EXTENSIONS, row))
    return home


def test_a_row_is_all_that_an_extension_takes(toy, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, toy.__name__, toy)
    with pytest.raises(SystemExit, match="0"):
        trace.main(["toy"])
    assert capsys.readouterr().out == "the toy ran\n"


@pytest.mark.usefixtures("toy")
def test_a_home_is_imported_at_use():
    """The package alone is there: what it offers can be listed, and its home is missed at the call."""
    assert "toy" in offers("commands")
    with pytest.raises(ModuleNotFoundError):
        load("commands", "toy")


@pytest.mark.usefixtures("toy")
def test_what_nobody_offers_is_named_with_what_there_is():
    with pytest.raises(OptionError, match=r"'tot'.*toy"):
        load("commands", "tot")

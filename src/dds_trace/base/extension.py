"""The door of `extensions/`: what a building adds to the main house, which imports none of them and loads it at use."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from importlib import import_module
from typing import Any

from .errors import OptionError


@dataclass(frozen=True, slots=True, kw_only=True)
class Extension:
    """A row of `dds_trace.extensions.EXTENSIONS`; a value is the home of an object, `module:name` below the package, or of a module.

    Attributes:
        name: of its package.
        commands: words of a command -> its typer app.
        choices: an option of a recording -> the names that it takes.
        checks: what `doctor` looks at -> a function that yields part, name, whether it works, and details.
        details: a name -> a function that makes frames of `Details`.
        exports: a kind of `--export` -> a function of an analysis and a folder that returns the files it wrote.
        payloads: data that `--data` reads -> its `Source`.
        storages: suffix of a file with our events -> its reader.
        figures: a name -> figures of the report.
        findings: a frame of `Details` with rows -> checks, by the code of the check that they follow.
        roles: a role of `record` -> its recording.
        parts: what the main house asks for by a name of its own.
    """

    name: str
    commands: Mapping[str, str] = field(default_factory=dict)
    choices: Mapping[str, str] = field(default_factory=dict)
    checks: Mapping[str, str] = field(default_factory=dict)
    details: Mapping[str, str] = field(default_factory=dict)
    exports: Mapping[str, str] = field(default_factory=dict)
    payloads: Mapping[str, str] = field(default_factory=dict)
    storages: Mapping[str, str] = field(default_factory=dict)
    figures: Mapping[str, str] = field(default_factory=dict)
    findings: Mapping[str, str] = field(default_factory=dict)
    roles: Mapping[str, str] = field(default_factory=dict)
    parts: Mapping[str, str] = field(default_factory=dict)


def offers(kind: str) -> dict[str, Callable[[], Any]]:
    """Return what all extensions offer in the field `kind`: name -> a call that imports and returns the object."""
    homes: dict[str, Callable[[], Any]] = {}
    for extension in import_module("dds_trace.extensions").EXTENSIONS:
        for name, home in getattr(extension, kind).items():
            homes[name] = partial(_load, f"dds_trace.extensions.{extension.name}.{home}")
    return homes


def load(kind: str, name: str) -> Any:
    """Return the object `name` of the field `kind`; an `OptionError` if no extension offers it."""
    offered = offers(kind)
    if name not in offered:
        raise OptionError(f"there is no {name!r} among the {kind}; choose one of {', '.join(offered)}")
    return offered[name]()


def _load(home: str) -> Any:
    module, _, name = home.partition(":")
    module = module.rstrip(".")  # of the package itself
    return getattr(import_module(module), name) if name else import_module(module)

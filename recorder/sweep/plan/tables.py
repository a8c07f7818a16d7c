"""The tables of a plan and their keys, collected from the records that hold their values."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import Enum
from typing import TYPE_CHECKING, TypeAlias

from dds_trace.base import limits

from .cells import AXES, DEFAULTS, Cell, Key
from .link import PRESETS, Link
from .plan import DeviceSettings, Network, RunSettings, Search

if TYPE_CHECKING:
    from collections.abc import Mapping

    from _typeshed import DataclassInstance

    from dds_trace.base.limits import Limit

    Kind: TypeAlias = type[str | int | float | bool]

INSTALLED = "installed"
"""Value of `backend` that stands for every middleware of this machine."""


@dataclass(frozen=True, slots=True)
class TableKey:
    """A key of a plan where it stands.

    Attributes:
        key: its meaning and validator.
        kind: type of its value; a float may be written as a whole number.
        default: value where the plan says nothing; None and empty texts and tuples are told by `key.default`.
        takes_list: whether a list of values may stand in the place of one.
    """

    key: Key
    kind: Kind
    default: object
    takes_list: bool = False


@dataclass(frozen=True, slots=True)
class Table:
    """A table of a plan.

    Attributes:
        meaning: what it is for.
        keys: name -> key, in the order of the documentation.
        subtables: names of the tables within it.
        is_repeated: whether it may stand several times, as `[[name]]`.
    """

    meaning: str
    keys: Mapping[str, TableKey]
    subtables: tuple[str, ...] = ()
    is_repeated: bool = False

    @property
    def words(self) -> tuple[str, ...]:
        """Everything that may stand in it."""
        return (*self.keys, *self.subtables)


def _keys_of(record: DataclassInstance, *, without: str = "") -> dict[str, TableKey]:
    """Return the keys that fields of a record are."""
    found = {}
    for each in fields(record):
        if "key" in each.metadata and each.name != without:
            default = getattr(record, each.name)
            kind = str if default is None or isinstance(default, tuple | Enum) else type(default)
            shown = default.value if isinstance(default, Enum) else default
            found[each.name] = TableKey(each.metadata["key"], kind, shown, isinstance(default, tuple))
    return found


def _text(meaning: str, limit: Limit = limits.TEXT, default: str = "none") -> TableKey:
    return TableKey(Key(meaning, limit, default=default), str, None)


_AXES = {name: TableKey(axis, axis.kind, DEFAULTS[name], takes_list=True) for name, axis in AXES.items()}

TABLES: Mapping[str, Table] = {
    "": Table(
        "At the top of the file, before any table.",
        {
            "name": _text("name of the folder below `--out`", limits.FILE_NAME, "the name of the file"),
            "description": _text("what the plan is for, in words"),
        },
        ("axes", "matrix", "exclude", "run", "devices", "network", "link", "search"),
    ),
    "axes": Table(
        "Every combination of the values is a cell; `[axes]` is combined with each `[[matrix]]`. Several `[[axes]]` are each combined "
        "with every `[[matrix]]`, for values that belong together (a vendor and its own bridge). Each key takes one value or a list.",
        _AXES,
        is_repeated=True,
    ),
    "matrix": Table("The same keys as `[axes]`.", _AXES, is_repeated=True),
    "exclude": Table(
        "Cells to leave out: those whose every named axis has one of the values. The same keys as `[axes]`, and",
        {**_AXES, "reason": _text("why, shown by `--dry-run`")},
        is_repeated=True,
    ),
    "run": Table("What all cells have in common.", _keys_of(RunSettings())),
    "devices": Table(
        "The two devices; both are this machine unless the relay has `ssh`.",
        {
            "connectivity": _text(
                "the link as the traces name it: `loopback`, `wired`, `wireless`, or a word of yours",
                limits.NAME,
                "`loopback` on one machine, `wired` between namespaces, `emulated-NAME` over `[link]`; looked up on two devices",
            )
        },
        ("ping", "relay"),
    ),
    "devices.ping": Table("The ping's device: this machine.", _keys_of(DeviceSettings(), without="ssh")),
    "devices.relay": Table(
        "The relay's device. **A plan is code**: these run on both machines.", _keys_of(DeviceSettings())
    ),
    "network": Table("On one machine.", _keys_of(Network())),
    "link": Table(
        "An emulated link between two namespaces of this machine, equal in both directions.",
        {
            "preset": _text(
                f"a link to start from, of which single values can be changed: {', '.join(f'`{name}`' for name in PRESETS)}",
                limits.OneOf(tuple(PRESETS)),
            ),
            **_keys_of(Link()),
        },
    ),
    "search": Table("What `--max-rate` looks for.", _keys_of(Search())),
}
"""Dotted name -> table, the root's name being empty; every key that a plan may have is here."""

PLAN_LIMITS: Mapping[str, Mapping[str, Limit]] = {
    table: {name: key.key.limit for name, key in each.keys.items()} for table, each in TABLES.items()
}
"""Table of a plan -> its keys -> the validator of each."""


def axis_choices(name: str) -> list[str]:
    """Return the values that an axis takes, the default first; empty where it takes any of its type."""
    axis, default = AXES[name], getattr(Cell(), name)
    if not axis.choices:
        return []
    own = [INSTALLED] if name == "backend" else []
    return list(dict.fromkeys([*filter(None, [default]), *axis.choices, *own]))

"""Tables of a TOML file with checked values; errors name file, table and key."""

from __future__ import annotations

import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from typing import TYPE_CHECKING, TypeVar

from dds_trace.base import limits
from dds_trace.base.errors import OptionError
from dds_trace.base.limits import Limit
from dds_trace.base.printable import printable

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    _Record = TypeVar("_Record", bound=DataclassInstance)

_T = TypeVar("_T")
_D = TypeVar("_D")

_KIND_NAMES = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    dict: "a table",
    list: "a list of tables",
}


@dataclass(frozen=True, slots=True)
class TomlTable:
    values: Mapping[str, object]
    path: str
    key: str = ""
    validators: Mapping[str, Mapping[str, Limit]] = field(default_factory=dict)

    @classmethod
    def parse(cls, text: str, path: str, validators: Mapping[str, Mapping[str, Limit]] | None = None) -> TomlTable:
        try:
            return cls(tomllib.loads(text), path, validators=validators or {})
        except RecursionError as err:
            raise OptionError(f"{path}: a value is nested deeper than any plan needs") from err
        except ValueError as err:  # also of an integer of 5000 digits
            raise OptionError(f"{path}: {printable(err)}") from err

    @property
    def where(self) -> str:
        return f"{self.path}: [{self.key}]" if self.key else self.path

    def table(self, key: str) -> TomlTable:
        return TomlTable(self.take(key, dict, {}), self.path, f"{self.key}.{key}".lstrip("."), self.validators)

    def tables(self, key: str) -> list[TomlTable]:
        if isinstance(self.values.get(key), dict):
            return [self.table(key)]
        return [
            TomlTable(self.check(f"{key} number {number}", table, dict), self.path, f"[{key}]", self.validators)
            for number, table in enumerate(self.take(key, list, []), 1)
        ]

    def take(self, key: str, kind: type[_T], default: _D) -> _T | _D:
        return self.check(key, self.values[key], kind) if key in self.values else default

    def check(self, key: str, value: object, kind: type[_T]) -> _T:
        """Return the checked value as a `kind`; a whole number passes as a float, but a bool is no number."""
        is_number = kind is float and isinstance(value, int)
        if not (is_number or isinstance(value, kind)) or (kind is not bool and isinstance(value, bool)):
            raise OptionError(f"{self.where}: {key} is {limits.shown(value)}, not {_KIND_NAMES[kind]}")
        limit = self.validators.get(self.key.strip("[]"), {}).get(key)
        fault = None if limit is None else limit.fault(value)
        if fault is not None:
            raise OptionError(f"{self.where}: {key} is {limits.shown(value)}; {fault}")
        return kind(value) if is_number else value  # type: ignore[call-arg,return-value]  # float of an int

    def choose(self, key: str, value: object, choices: Collection[str]) -> str:
        if not isinstance(value, str) or value not in choices:
            near = limits.nearest(value if isinstance(value, str) else "", choices)
            raise OptionError(f"{self.where}: {key} is {limits.shown(value)}; {near}")
        return value

    def allow(self, *keys: str) -> None:
        for key in self.values:
            if key not in keys:
                raise OptionError(f"{self.where}: there is no {limits.shown(key)}; {limits.nearest(key, keys)}")

    def fill(self, defaults: _Record, *others: str) -> _Record:
        """Return `defaults` with the table's values, of their types (None: a text, a tuple: texts); `others` may be there."""
        names = [field.name for field in fields(defaults)]
        self.allow(*names, *others)
        return replace(
            defaults, **{name: self._like(name, getattr(defaults, name)) for name in names if name in self.values}
        )

    def _like(self, name: str, default: object) -> object:
        value = self.values[name]
        if isinstance(default, Enum):
            choices = {str(choice.value): choice for choice in type(default)}
            return choices[self.choose(name, value, choices)]
        if isinstance(default, tuple):
            return tuple(self.check(name, item, str) for item in (value if isinstance(value, list) else [value]))
        return self.check(name, value, str if default is None else type(default))

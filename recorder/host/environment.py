"""A middleware's configuration outside the command line: environment variables, and files by name and hash."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

_INLINE_STARTS = ("<", "{", "str://")
"""A value that starts so is a configuration itself, not the name of a file."""


@dataclass(frozen=True, slots=True)
class ConfigurationVariable:
    """A variable with one entry, or several with a separator."""

    name: str
    separator: str | None = None


@dataclass(frozen=True, slots=True)
class MiddlewareEnvironment:
    """The variables and files by which a middleware can be configured.

    Attributes:
        settings: variables whose values a session keeps.
        configuration: variables with files or their text, whose hashes a session keeps.
        files: files that the middleware loads from the working directory by itself.
    """

    settings: tuple[str, ...] = ()
    configuration: tuple[ConfigurationVariable, ...] = ()
    files: tuple[str, ...] = ()

    def read_settings(self, variables: Mapping[str, str]) -> dict[str, str]:
        """Return the `settings` that are set."""
        return {name: variables[name] for name in self.settings if name in variables}

    def hash_configuration(self, variables: Mapping[str, str], folder: Path) -> dict[str, list[dict[str, str | None]]]:
        """Return each configuration in effect: variable, or `./NAME` for a file in `folder` -> `name` and `sha256` of each entry.

        The name of inline text is `inline`; the hash of a file that cannot be read is null.
        """
        hashes = {
            variable.name: [_hashed(entry) for entry in _entries(variables[variable.name], variable.separator)]
            for variable in self.configuration
            if variables.get(variable.name)
        }
        return hashes | {f"./{name}": [_hashed(str(folder / name))] for name in self.files if (folder / name).is_file()}


def join_environments(environments: Iterable[MiddlewareEnvironment]) -> MiddlewareEnvironment:
    """Return all variables and files in one environment."""
    every = list(environments)
    return MiddlewareEnvironment(
        settings=tuple(dict.fromkeys(name for one in every for name in one.settings)),
        configuration=tuple(dict.fromkeys(variable for one in every for variable in one.configuration)),
        files=tuple(dict.fromkeys(name for one in every for name in one.files)),
    )


def _entries(value: str, separator: str | None) -> list[str]:
    # Inline XML or JSON may contain the separator.
    is_inline = value.lstrip().startswith(_INLINE_STARTS)
    parts = [value] if is_inline or separator is None else value.split(separator)
    return [part.strip() for part in parts if part.strip()]


def _hashed(entry: str) -> dict[str, str | None]:
    path = Path(entry.removeprefix("file://"))
    try:
        return {"name": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    except OSError:
        if entry.startswith(_INLINE_STARTS) or "=" in entry:
            return {"name": "inline", "sha256": hashlib.sha256(entry.encode()).hexdigest()}
        return {"name": path.name, "sha256": None}

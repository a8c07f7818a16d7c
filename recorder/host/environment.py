"""The configuration of a middleware that lies outside the command line: environment variables and files.

Of a file its name and hash are kept, never its folder or its text.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

_INLINE_STARTS = ("<", "{", "str://")
"""First characters of a value that is a configuration itself and no file's name."""


@dataclass(frozen=True, slots=True)
class ConfigurationVariable:
    """An environment variable that names the configuration of a middleware.

    Attributes:
        name: the environment variable.
        separator: text between several entries of its value; None if it holds one only.
    """

    name: str
    separator: str | None = None


@dataclass(frozen=True, slots=True)
class MiddlewareEnvironment:
    """The variables and files by which a middleware can be configured.

    Attributes:
        settings: variables whose values are settings; a session keeps them whole.
        configuration: variables that name files or hold their text; a session keeps hashes.
        files: names of files that the middleware loads from the working directory without being told.
    """

    settings: tuple[str, ...] = ()
    configuration: tuple[ConfigurationVariable, ...] = ()
    files: tuple[str, ...] = ()

    def read_settings(self, variables: Mapping[str, str]) -> dict[str, str]:
        """Return those of `settings` that are set, with their values."""
        return {name: variables[name] for name in self.settings if name in variables}

    def hash_configuration(
        self, variables: Mapping[str, str], folder: Path
    ) -> dict[str, list[dict[str, str | None]]]:
        """Return the hash of each configuration in effect.

        Args:
            variables: environment variables.
            folder: the working directory.

        Returns:
            Variable (or, for a file in `folder`, `./NAME`) -> one entry for each file or inline text: `name` (the
            file's base name or `inline`) and `sha256`, null where the file cannot be read.
        """
        hashes = {
            variable.name: [
                _hashed(entry) for entry in _entries(variables[variable.name], variable.separator)
            ]
            for variable in self.configuration
            if variables.get(variable.name)
        }
        return hashes | {
            f"./{name}": [_hashed(str(folder / name))] for name in self.files if (folder / name).is_file()
        }


def join_environments(environments: Iterable[MiddlewareEnvironment]) -> MiddlewareEnvironment:
    """Return one environment with the variables and files of all, each once."""
    every = list(environments)
    return MiddlewareEnvironment(
        settings=tuple(dict.fromkeys(name for each in every for name in each.settings)),
        configuration=tuple(dict.fromkeys(variable for each in every for variable in each.configuration)),
        files=tuple(dict.fromkeys(name for each in every for name in each.files)),
    )


def _entries(value: str, separator: str | None) -> Iterator[str]:
    # Inline XML or JSON may hold the separator itself; it is hashed whole.
    inline = value.lstrip().startswith(_INLINE_STARTS)
    parts = [value] if inline or separator is None else value.split(separator)
    return (part.strip() for part in parts if part.strip())


def _hashed(entry: str) -> dict[str, str | None]:
    path = Path(entry.removeprefix("file://"))
    try:
        return {"name": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    except OSError:
        if entry.startswith(_INLINE_STARTS) or "=" in entry:
            return {"name": "inline", "sha256": hashlib.sha256(entry.encode()).hexdigest()}
        return {"name": path.name, "sha256": None}

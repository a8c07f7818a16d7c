"""Texts of configuration files: YAML that people can read, and XML."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeGuard
from xml.etree.ElementTree import Element, indent, tostring

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

# Texts that YAML 1.1 and 1.2 both read as strings without quotes.
_PLAIN = re.compile(r"(?!(?:true|false|yes|no|on|off|null|y|n)$)[A-Za-z_/][\w./:-]*", re.IGNORECASE)


def yaml_text(value: Mapping[str, object]) -> str:
    """Return `value` (mappings, lists, strings, numbers, booleans) as a YAML document in block style."""
    return "\n".join(_yaml_lines(value)) + "\n"


def _yaml_lines(value: Mapping[str, object] | Sequence[object]) -> Iterator[str]:
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _yaml_entry(f"{_yaml_scalar(name)}:", inner)
    else:
        for inner in value:
            lines = list(_yaml_lines(inner)) if _is_nested(inner) else [_yaml_scalar(inner)]
            yield f"- {lines[0]}"
            yield from (f"  {line}" for line in lines[1:])


def _yaml_entry(name: str, value: object) -> Iterator[str]:
    if _is_nested(value):
        yield name
        yield from (f"  {line}" for line in _yaml_lines(value))
    else:
        yield f"{name} {_yaml_scalar(value)}"


def _is_nested(value: object) -> TypeGuard[Mapping[str, object] | list[object]]:
    """Return whether a value takes lines of its own; empty ones do not."""
    return isinstance(value, (dict, list)) and bool(value)


def _yaml_scalar(value: object) -> str:
    if isinstance(value, str) and _PLAIN.fullmatch(value) and not value.endswith(":"):
        return value
    return json.dumps(value)  # YAML holds JSON: numbers, booleans, quoted strings, empty lists


def element(tag: str, /, *content: Element | str, **attributes: str) -> Element:
    """Return an XML element that holds other elements, or text."""
    made = Element(tag, attributes)
    for part in content:
        if isinstance(part, str):
            made.text = part
        else:
            made.append(part)
    return made


def xml_text(root: Element) -> str:
    """Return `root` as an indented XML document."""
    indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{tostring(root, encoding="unicode")}\n'

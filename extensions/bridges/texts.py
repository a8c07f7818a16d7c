"""YAML and XML of configuration files."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from xml.etree.ElementTree import Element, indent, tostring

# YAML 1.1 and 1.2 both read these as strings without quotes.
_PLAIN = re.compile(r"(?!(?:true|false|yes|no|on|off|null|y|n)$)[A-Za-z_/][\w./:-]*", re.IGNORECASE)


def yaml_text(value: Mapping[str, object]) -> str:
    return "\n".join(_yaml_lines(value)) + "\n"


def _yaml_lines(value: Mapping[str, object] | Sequence[object]) -> Iterator[str]:
    if isinstance(value, Mapping):
        for name, inner in value.items():
            key = f"{_yaml_scalar(name)}:"
            if isinstance(inner, dict | list) and inner:
                yield key
                yield from (f"  {line}" for line in _yaml_lines(inner))
            else:
                yield f"{key} {_yaml_scalar(inner)}"
    else:
        for inner in value:
            lines = [_yaml_scalar(inner)]
            if isinstance(inner, dict | list) and inner:
                lines = list(_yaml_lines(inner))
            yield f"- {lines[0]}"
            yield from (f"  {line}" for line in lines[1:])


def _yaml_scalar(value: object) -> str:
    if isinstance(value, str) and _PLAIN.fullmatch(value) and not value.endswith(":"):
        return value
    return json.dumps(value)  # JSON is YAML


def element(tag: str, /, *content: Element | str, **attributes: str) -> Element:
    parent = Element(tag, attributes)
    for part in content:
        if isinstance(part, str):
            parent.text = part
        else:
            parent.append(part)
    return parent


def xml_text(root: Element) -> str:
    indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{tostring(root, encoding="unicode")}\n'

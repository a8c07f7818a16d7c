"""What a Fast DDS profile file of the user's asks for, read from its XML."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

if TYPE_CHECKING:
    from collections.abc import Iterator

_KINDS = {
    "UDPv4": "udp",
    "UDPv6": "udp",
    "TCPv4": "tcp",
    "TCPv6": "tcp",
    "SHM": "shm",
}


@dataclass(frozen=True, slots=True)
class ProfileRequest:
    """What the default participant of a profile file asks for.

    Attributes:
        protocols: `udp`, `tcp` and `shm` of its own transports, sorted; empty if it names none.
        receive_buffer_bytes: of its UDP transports, the smallest; 0 if one leaves it out.
        send_buffer_bytes: likewise.
        interfaces: addresses or names of interfaces that its transports are restricted to, sorted.
        replaces_builtin: says `useBuiltinTransports` false; otherwise its transports come beside the built-in ones.
    """

    protocols: tuple[str, ...] = ()
    receive_buffer_bytes: int = 0
    send_buffer_bytes: int = 0
    replaces_builtin: bool = False
    interfaces: tuple[str, ...] = ()

    @property
    def transport(self) -> str:
        """The asked transport in the words of `--transport`, `default` where the profile asks for several or none."""
        return self.protocols[0] if len(self.protocols) == 1 and self.protocols[0] != "tcp" else "default"


def read_profile_request(text: str) -> ProfileRequest:
    """Return what the default participant of a profile file asks for; nothing if it has none or is no XML."""
    try:
        root = ET.fromstring(text)  # noqa: S314 - the user's own file, which Fast DDS reads as well
    except ET.ParseError:
        return ProfileRequest()
    participant = next(
        (each for each in _named(root, "participant") if each.get("is_default_profile") == "true"), None
    )
    if participant is None:
        return ProfileRequest()
    descriptors = {_text(each, "transport_id"): each for each in _named(root, "transport_descriptor")}
    wanted = [
        descriptors[name]
        for group in _named(participant, "userTransports")
        for each in _named(group, "transport_id")
        if (name := (each.text or "").strip()) in descriptors
    ]
    over_udp = [each for each in wanted if _KINDS.get(_text(each, "type")) == "udp"]
    return ProfileRequest(
        protocols=tuple(
            sorted({_KINDS[_text(each, "type")] for each in wanted if _text(each, "type") in _KINDS})
        ),
        receive_buffer_bytes=_smallest(over_udp, "receiveBufferSize"),
        send_buffer_bytes=_smallest(over_udp, "sendBufferSize"),
        replaces_builtin=_text(participant, "useBuiltinTransports").lower() == "false",
        interfaces=tuple(sorted({name for each in wanted for name in _whitelist(each)})),
    )


def _named(parent: ET.Element, name: str) -> Iterator[ET.Element]:
    """Yield the elements of a name below `parent`, whatever their XML namespace."""
    return (each for each in parent.iter() if each.tag.rpartition("}")[2] == name)


def _whitelist(descriptor: ET.Element) -> Iterator[str]:
    """Yield the addresses and names of interfaces that a transport is restricted to, in either of Fast DDS's two lists."""
    for name in ("interfaceWhiteList", "allowlist"):
        for group in _named(descriptor, name):
            for each in group:
                if text := (each.get("name") or each.text or "").strip():
                    yield text


def _text(parent: ET.Element, name: str) -> str:
    return next(((each.text or "").strip() for each in _named(parent, name)), "")


def _smallest(descriptors: list[ET.Element], name: str) -> int:
    texts = [_text(each, name) for each in descriptors]
    return min((int(text) if text.isdigit() else 0 for text in texts), default=0)

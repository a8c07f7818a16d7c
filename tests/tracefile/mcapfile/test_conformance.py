"""MCAP's own conformance suite: 416 files, each with the records that a reader must find in it.

`tests/data/mcap-conformance.tar.xz` is the suite's data (MIT licence; its origin is noted inside).
"""

from __future__ import annotations

import json
import tarfile
from pathlib import Path
from typing import Any

import pytest
from mcap.opcode import Opcode

from dds_trace.tracefile.mcapfile.record_stream import read_records
from dds_trace.tracefile.mcapfile.records import LAYOUTS

SUITE = Path(__file__).parents[2] / "data" / "mcap-conformance.tar.xz"
NOT_LISTED = {Opcode.MESSAGE_INDEX}  # the suite names no index of messages, nor an attachment's CRC


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    folder = tmp_path_factory.mktemp("conformance")
    with tarfile.open(SUITE) as archive:
        for member in archive.getmembers():
            if member.isfile():
                (folder / Path(member.name).name).write_bytes(archive.extractfile(member).read())
    return folder


def test_every_file_of_the_suite_holds_the_records_it_must(suite):
    files = sorted(suite.glob("*.mcap"))
    assert len(files) == 416
    wrong = [file.name for file in files if found_in(file) != expected_of(file)]
    assert wrong == []


def test_the_suite_has_every_kind_of_record_that_it_can_list(suite):
    kinds = {kind for file in suite.glob("*.json") for kind, _ in expected_of(file)}
    assert kinds == {LAYOUTS[opcode].name for opcode in Opcode} - {"Chunk", "MessageIndex"}


def expected_of(file: Path) -> list[tuple[str, dict[str, Any]]]:
    records = json.loads(file.with_suffix(".json").read_text())["records"]
    return [(record["type"], dict(record["fields"])) for record in records]


def found_in(file: Path) -> list[tuple[str, dict[str, Any]]]:
    return [
        (LAYOUTS[opcode].name, {name: as_listed(value) for name, value in fields.items() if name != "crc"})
        for opcode, fields in read_records(file)
        if opcode not in NOT_LISTED
    ]


def as_listed(value: Any) -> Any:
    """A field as the suite writes it: numbers and bytes as text, so that no JSON parser rounds them."""
    if isinstance(value, int):
        return str(value)
    if isinstance(value, bytes):
        return [str(byte) for byte in value]
    if isinstance(value, dict):
        return {str(key): as_listed(held) for key, held in value.items()}
    return value

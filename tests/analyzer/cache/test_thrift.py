"""Thrift's compact protocol: what is read is written as it was, of any struct and of real footers."""

import io

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dds_trace.analyzer.cache import thrift
from dds_trace.analyzer.cache.thrift import Elements, Value, read_struct, write_struct

integers = {
    thrift.I16: st.integers(-(2**15), 2**15 - 1),
    thrift.I32: st.integers(-(2**31), 2**31 - 1),
    thrift.I64: st.integers(-(2**63), 2**63 - 1),
    thrift.BYTE: st.integers(0, 255),
    thrift.BINARY: st.binary(max_size=200),
    thrift.DOUBLE: st.binary(min_size=8, max_size=8),
}
bools = st.sampled_from([thrift.TRUE, thrift.FALSE])
scalars = st.one_of(
    *(st.builds(Value, st.just(kind), values) for kind, values in integers.items()),
    st.builds(Value, bools, st.none()),
)


def lists_of(kind, values):
    return st.builds(Elements, st.just(kind), st.lists(values, max_size=20))


def structs_of(values):
    return st.dictionaries(st.integers(1, 2**15 - 1), values, max_size=20)


flat_lists = st.one_of(
    *(lists_of(kind, values) for kind, values in integers.items()), lists_of(thrift.TRUE, bools)
).map(lambda elements: Value(thrift.LIST, elements))
values = st.recursive(
    scalars | flat_lists,
    lambda inner: st.one_of(
        structs_of(inner).map(lambda fields: Value(thrift.STRUCT, fields)),
        lists_of(thrift.STRUCT, structs_of(inner)).map(lambda elements: Value(thrift.LIST, elements)),
    ),
    max_leaves=20,
)


@given(structs_of(values))
def test_a_struct_comes_back(fields):
    assert read_struct(write_struct(fields)) == fields


def test_the_bytes_are_those_of_the_specification():
    fields = {
        1: Value(thrift.I32, 150),
        17: Value(thrift.BINARY, b"ab"),
        16: Value(thrift.I64, -1),
        18: Value(thrift.TRUE, None),
    }
    assert write_struct(fields) == bytes.fromhex("15ac02 f601 18026162 11 00")
    fields = {300: Value(thrift.LIST, Elements(thrift.I16, [0] * 15))}
    assert write_struct(fields) == bytes.fromhex("09d804 f40f" + "00" * 15 + "00")


def footer_of(table, **options):
    stream = io.BytesIO()
    pq.write_table(table, stream, **options)
    packed = stream.getvalue()
    return packed[-8 - int.from_bytes(packed[-8:-4], "little") : -8]


@pytest.mark.parametrize("rows", [0, 3, 1000])
def test_a_footer_of_a_parquet_file_is_written_as_it_was(rows):
    table = pa.table(
        {
            "number": pa.array(range(rows), pa.uint16()),
            "text": pa.array(["x"] * rows, pa.string()).dictionary_encode(),
            "share": pa.array([0.5] * rows),
            "is": pa.array([None] * rows, pa.bool_()),
            "at": pa.array(range(rows), pa.timestamp("ns", tz="UTC")),
        }
    )
    for options in ({}, {"row_group_size": 100, "compression": "zstd", "write_page_index": True}):
        footer = footer_of(table, **options)
        assert write_struct(read_struct(footer)) == footer


@pytest.mark.parametrize(
    "damaged", [b"", b"\x15", b"\x18\x05ab", b"\x1b\x00\x00", b"\x1c" * 5000, b"\x15" + b"\x80" * 9]
)
def test_what_is_no_struct_is_a_value_error(damaged):
    with pytest.raises(ValueError, match="no Thrift struct"):
        read_struct(damaged)

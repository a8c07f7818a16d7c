from __future__ import annotations

import numpy as np
import pytest

from dds_trace.tracefile.format.wire import MESSAGE_ROW, row_texts, rows_of_text


def rows_of(run_id, count):
    rows = np.zeros(count, MESSAGE_ROW)
    rows["run_id"], rows["sequence"], rows["repeats"] = run_id, np.arange(count), 3
    return rows


def test_a_record_has_61_bytes_without_padding():
    assert MESSAGE_ROW.itemsize == 61
    run_and_sequence = "0100000000000000" * 2
    assert rows_of(1, 2)[1].tobytes().hex() == run_and_sequence + "00" * 13 + "0300" + "00" * 30


def test_texts_hold_one_run_each_and_give_every_record_back():
    rows = np.concatenate([rows_of(0x11, 8193), rows_of(0x22, 1)])
    texts = list(row_texts(rows))
    assert [(text["run_id"], text["messages"]) for text in texts] == [
        ("0000000000000011", 8192),
        ("0000000000000011", 1),
        ("0000000000000022", 1),
    ]
    assert np.concatenate([rows_of_text(text) for text in texts]).tobytes() == rows.tobytes()


@pytest.mark.parametrize("rows", [None, 7, "", "no base64!", "AAAA", "ä"])
def test_a_text_with_counts_alone_or_damaged_records_has_no_record(rows):
    assert len(rows_of_text({"run_id": "0000000000000011", "rows": rows})) == 0

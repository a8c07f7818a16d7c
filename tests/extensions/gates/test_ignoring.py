import polars as pl
import pytest
from roundtrip_frames import MS, PLAIN, in_runs

from dds_trace.base.errors import OptionError
from dds_trace.extensions.gates.compare import CompareOptions, compare_roundtrips
from dds_trace.extensions.gates.ignoring import (
    check_match,
    columns_to_ignore,
    ignored_sentences,
    match_without,
    unlike_columns,
)

SAME = {"bridge": "none", "domain_mode": "same"}
BRIDGED = {"bridge": "builtin", "domain_mode": "different"}
BRIDGE = match_without(["bridge", "domain_mode"])


def groups(*changed):
    return pl.DataFrame([{**PLAIN, **one} for one in changed])


def test_groups_pair_without_the_columns_in_which_they_differ():
    match = CompareOptions(metrics=("latency",), statistics=("p50",), match=BRIDGE)
    found = compare_roundtrips(in_runs([5 * MS] * 9, **SAME), in_runs([6 * MS] * 9, **BRIDGED), match)
    assert found.rows.select("ratio").item() == pytest.approx(1.2)
    assert not {"bridge", "domain_mode"} & set(found.rows.columns)


def test_a_side_with_two_groups_that_become_one_is_refused():
    both = groups(SAME, BRIDGED)
    with pytest.raises(OptionError, match=r"the new side has two results .* bridge \(none and builtin\), domain_mode"):
        check_match(both, "new side", BRIDGE)
    check_match(both, "new side", match_without([]))
    check_match(groups({"payload_bytes": 1}, {"payload_bytes": 2}), "base", BRIDGE)
    # A relay that left no trace is no second device.
    check_match(groups({"relay_device": None}, {}), "base", match_without(["relay_device"]))


@pytest.mark.parametrize("column", ["payload_bytes", "rate_hz", "data_type", "brigde", "ping_domain_id"])
def test_only_columns_of_the_match_beside_the_message_are_ignored(column):
    with pytest.raises(OptionError, match=rf"'{column}' cannot be ignored; choose from vendor, backend"):
        match_without([column])


def test_the_fewest_columns_that_pair_groups_and_keep_them_apart_are_offered(sentences):
    base, new = groups(SAME, {**SAME, "payload_bytes": 7}), groups({**BRIDGED, "payload_bytes": 7}, BRIDGED)
    assert columns_to_ignore(base, new) == ("bridge", "domain_mode")
    assert unlike_columns(base, new) == {"bridge": ("none", "builtin"), "domain_mode": ("same", "different")}
    ignored = ignored_sentences(base, new, BRIDGE)
    assert [sentence.split()[0] for sentence in ignored] == ["bridge", "domain_mode"]
    sentences(*ignored)
    # Two bridges beside each other would be pooled, other sizes are never compared, without a side there is nothing.
    assert columns_to_ignore(base, groups(BRIDGED, {**BRIDGED, "bridge": "zenoh"})) == ()
    assert columns_to_ignore(base, groups({"payload_bytes": 8})) == ()
    assert columns_to_ignore(base, groups(BRIDGED).clear()) == ()
    assert unlike_columns(base, groups(BRIDGED).clear()) == {}

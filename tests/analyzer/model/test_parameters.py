from dataclasses import fields

import pytest
from trace_files import ping_session, relay_session, run

from dds_trace.analyzer.model import parameters
from dds_trace.analyzer.model.columns import ROUNDTRIP_COLUMNS, SUMMARY_COLUMNS
from dds_trace.analyzer.model.parameters import (
    BRIDGE_MATCH_COLUMNS,
    CASE_COLUMNS,
    CELL_COLUMNS,
    CONTENDER_COLUMNS,
    MATCH_COLUMNS,
    PARAMETER_COLUMNS,
    PARAMETER_NAMES,
    SETTING_COLUMNS,
    KeyPart,
    Parameters,
    names_of,
    parameters_of,
    relay_domain_of,
)


def test_every_parameter_belongs_to_one_part():
    names = [name for part in KeyPart for name in names_of(part)]
    assert sorted(names) == sorted(PARAMETER_NAMES)
    assert tuple(field.name for field in fields(Parameters)) == PARAMETER_NAMES
    assert tuple(column.name for column in PARAMETER_COLUMNS) == PARAMETER_NAMES


def test_the_columns_of_the_first_contract_keep_their_places():
    first = (*PARAMETER_NAMES[:20],)
    assert tuple(column.name for column in SUMMARY_COLUMNS)[:20] == first
    assert tuple(column.name for column in ROUNDTRIP_COLUMNS)[3:23] == first


def test_slices_leave_out_what_they_say():
    devices = {"ping_device", "relay_device"}
    assert set(PARAMETER_NAMES) - set(MATCH_COLUMNS) == {"ping_domain_id", "relay_domain_id"}
    assert set(MATCH_COLUMNS) - set(BRIDGE_MATCH_COLUMNS) == {"bridge", "domain_mode"}
    assert CELL_COLUMNS == ("data_type", "payload_bytes", "rate_hz")
    assert set(MATCH_COLUMNS) - set(SETTING_COLUMNS) == set(CELL_COLUMNS)
    assert ("connectivity", "domain_mode", *CELL_COLUMNS, "ping_device", "relay_device") == CASE_COLUMNS
    assert all(devices <= set(columns) for columns in (BRIDGE_MATCH_COLUMNS, SETTING_COLUMNS))
    assert set(CONTENDER_COLUMNS) | set(CASE_COLUMNS) == set(MATCH_COLUMNS)
    assert not set(CONTENDER_COLUMNS) & set(CASE_COLUMNS)


@pytest.mark.parametrize("name", [name for name in dir(parameters) if name.endswith("_COLUMNS")])
def test_no_slice_names_a_parameter_twice(name):
    columns = getattr(parameters, name)
    assert len(set(columns)) == len(columns)


def test_a_relay_says_its_domain_itself():
    ping, relay = ping_session(domain_id=1), relay_session(domain_id=3)
    assert relay_domain_of(run(relay_domain_id=2), ping, relay) == 3
    assert relay_domain_of(run(relay_domain_id=2), ping, None) == 2
    assert relay_domain_of(run(relay_domain_id=None, bridge="none"), ping, None) == 1
    assert relay_domain_of(run(relay_domain_id=None, bridge="builtin"), ping, None) is None


def test_a_bridge_whose_far_side_nobody_names_stands_between_two_domains():
    key = parameters_of(run(relay_domain_id=None, bridge="builtin"), ping_session(), None)
    assert (key.relay_domain_id, key.domain_mode, key.relay_vendor) == (None, "different", None)


def test_keys_are_equal_by_their_values_and_sorted_with_null_last():
    ping = ping_session()
    with_relay, without = (parameters_of(run(), ping, relay) for relay in (relay_session(), None))
    assert with_relay == parameters_of(run(run_id=99), ping, relay_session(relay_id=5))
    assert sorted([without, with_relay], key=Parameters.order) == [with_relay, without]
    assert len({with_relay, without, parameters_of(run(), ping, None)}) == 2

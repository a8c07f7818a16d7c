import json

import pytest
from hostile_values import HOSTILE_NUMBERS, HOSTILE_TEXTS, json_values
from hypothesis import given, settings
from hypothesis import strategies as st
from trace_files import ping_session, run
from wording import numbers

from dds_trace.base import limits
from dds_trace.base.errors import OptionError, TraceFormatError
from dds_trace.tracefile.format.descriptions import Run, Session

LIMITS = {name: value for name, value in vars(limits).items() if name.isupper() and hasattr(value, "fault")}
FIELDS = [
    (kind, (name,))
    for kind, described in ((Session, ping_session()), (Run, run()))
    for name in json.loads(described.to_json())
] + [(Run, ("qos", name)) for name in run().qos.to_dict()]


@pytest.mark.parametrize("name", LIMITS)
def test_no_value_makes_a_validator_raise_anything_but_its_own_error(name):
    for value in (*HOSTILE_NUMBERS, *HOSTILE_TEXTS, None, True, [10**5000], {}, b"", object()):
        fault = LIMITS[name].fault(value)
        said = refusal(lambda value=value: limits.check(LIMITS[name], value, "--it"))
        if said is not None:
            assert said == f"--it {limits.shown(value)}: {fault}"
            assert "\n" not in said
            assert len(said) < 400
            said.encode()
        else:
            assert fault is None or value is None


def test_bounds_themselves_are_allowed_or_left_out_as_they_say(sentences):
    assert limits.DOMAIN_ID.fault(0) is limits.DOMAIN_ID.fault(232) is None
    assert limits.LENGTH_S.fault(0.1) is limits.LENGTH_S.fault(limits.YEAR_S) is None
    assert limits.WAIT_S.fault(0) is None
    faults = limits.DOMAIN_ID.fault(233), limits.LENGTH_S.fault(0), limits.WAIT_S.fault(-1)
    assert [numbers(fault) for fault in faults] == [[0, 232], [0, 31_622_400], [0, 31_622_400]]
    sentences(*faults)
    assert limits.PORT.fault(True) is not None
    assert limits.FILE_NAME.fault("..") is not None
    assert limits.FILE_NAME.fault("...") is None


def test_a_path_of_others_may_have_bytes_that_are_no_text(sentences):
    assert limits.INPUT.fault("\udcff") is None
    assert "UTF-8" in limits.FOLDER.fault("\udcff")
    assert limits.FOLDER.fault(".") is None
    assert limits.PATH.fault(".") == "a path ends with a name"
    assert numbers(limits.PATH.fault("a/" + "x" * 256)) == [255, 256]
    sentences(limits.PATH.fault("a/" + "x" * 256))


def refusal(action):
    try:
        action()
    except (OptionError, TraceFormatError) as error:
        return str(error)
    return None


def replaced(described, place, value):
    if len(place) == 1:
        return {**described, place[0]: value}
    return {**described, place[0]: replaced(described[place[0]], place[1:], value)}


@pytest.mark.parametrize(("kind", "place"), FIELDS, ids=str)
@settings(max_examples=8)
@given(value=json_values())
def test_any_value_of_any_field_is_taken_or_named_in_one_line(kind, place, value):
    good = ping_session() if kind is Session else run()
    text = json.dumps(replaced(json.loads(good.to_json()), place, value))
    said = refusal(lambda: kind.from_json(text, "x.mcap"))
    if said is not None:
        assert said.startswith("x.mcap: ")
        assert "\n" not in said
        return
    read = kind.from_json(text, "x.mcap")
    repr(read).encode()  # no lone surrogate is left
    json.dumps(json.loads(read.to_json()), ensure_ascii=False).encode()


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("domain_id", 10**400, "401 digits"),
        ("domain_id", 2**31, "'domain_id' .* is 2147483648; .* 0 and 2147483647"),
        ("wall_anchor_ns", 2**63 - 1, "'wall_anchor_ns' .* is 9223372036854775807; a time"),
        ("host", {"cores": 10**400}, "401 digits"),
        ("dropped_events", -1, "'dropped_events' .* is -1; .* 0 and 281474976710655"),
    ],
    ids=["long", "domain", "time", "long in host", "count"],
)
def test_a_value_that_no_column_holds_is_named(field, value, said, sentences):
    text = json.dumps(replaced(json.loads(ping_session().to_json()), (field,), value))
    with pytest.raises(TraceFormatError, match=said) as error:
        Session.from_json(text, "x.mcap")
    sentences(str(error.value))


def test_a_lone_surrogate_is_spelled_out_and_a_pair_is_a_character():
    described = replaced(json.loads(ping_session().to_json()), ("device",), "pi\ud83d\ude00\udcff")
    text = json.dumps(described)
    assert "\\ud83d\\ude00\\udcff" in text
    assert Session.from_json(text, "x.mcap").device == "pi\U0001f600\\udcff"


@given(depth=st.integers(1000, 5000))
@settings(max_examples=3)
def test_a_description_nested_without_end_is_one_line(depth):
    text = json.dumps(json.loads(ping_session().to_json()))[:-1] + f', "x": {"[" * depth * 100}'
    with pytest.raises(TraceFormatError, match=r"nested deeper|is not JSON"):
        Session.from_json(text, "x.mcap")

import pytest

from dds_trace.base.errors import OptionError
from dds_trace.extensions.campaigns.plan.commands import ping_arguments, relay_arguments
from dds_trace.extensions.campaigns.plan.flows import recorded_together, relay_places
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.plan.schedule import schedule

NETWORK = "[network]\nnamespaces = true\n"
DEVICES = "".join(f"[[devices]]\nssh = 'pi@{name}'\nname = '{name}'\n" for name in ("left", "right"))


def plan_of(axes, more="", **options):
    return parse_plan(f"{more}[axes]\nbackend = 'cyclonedds'\n{axes}", "p", "p.toml", **options)


def given(arguments, option):
    return [arguments[at + 1] for at, word in enumerate(arguments) if word == option]


def test_relays_of_each_host_have_numbers_and_the_hosts_names():
    (cell,) = plan_of("relays = 2\nhosts = 3", NETWORK).cells
    assert cell.name == "cyclonedds_same_binary_10Hz_relays-2_hosts-3"
    assert relay_places(cell) == [(1, 0), (2, 0), (3, 1), (4, 1), (5, 2), (6, 2)]
    plan = plan_of("relays = 2\nhosts = 3", NETWORK)
    last = relay_arguments(plan, cell.relay, position=relay_places(cell)[-1])
    assert (given(last, "--relay-id"), given(last, "--device")) == (["6"], ["host-3"])
    ping = ping_arguments(plan, cell, 5.0, "10.0.0.2", ["10.0.0.3", "10.0.0.4"])
    assert given(ping, "--relays") == ["6"]
    assert {"relays=6", "hosts=3"} <= set(given(ping, "--setting"))
    assert not given(ping, "--peer")


def test_a_backend_with_addresses_gets_one_for_each_host():
    zenoh = parse_plan(f"{NETWORK}[axes]\nbackend = 'zenoh'\nhosts = [1, 2]", "p", "p.toml")
    peers = [given(ping_arguments(zenoh, cell, 5.0, "a", ["b", "c"]), "--peer") for cell in zenoh.cells]
    assert peers == [["a"], ["a", "b"]]


def test_one_relay_is_started_as_ever():
    (cell,) = plan_of("relays = 1").cells
    assert cell.name == "cyclonedds_same_binary_10Hz"
    assert "--relay-id" not in relay_arguments(plan_of("relays = 1"), cell.relay)


@pytest.mark.parametrize(("axis", "letter", "topics"), [("pings", "p", []), ("topics", "t", ["t1", "t2", "t3"])])
def test_several_senders_run_together(axis, letter, topics):
    plan = plan_of(f"{axis} = [1, 3]")
    groups = schedule(plan)
    together = [cells for group in groups for cells in recorded_together(group.cells)]
    assert [[cell.flow for cell in cells] for cells in together] == [[""], [f"{letter}{n}" for n in (1, 2, 3)]]
    one = together[1][1]
    arguments = ping_arguments(plan, one, 5.0, None)
    assert given(arguments, "--flow") == topics[1:2]
    assert {f"{axis}=3", f"flow={letter}2"} <= set(given(arguments, "--setting"))
    assert given(relay_arguments(plan, one.relay), "--flow") == topics


def test_each_device_of_a_list_has_its_own_relay():
    plan = plan_of("hosts = 2", DEVICES)
    places = relay_places(plan.cells[0])
    names = [given(relay_arguments(plan, plan.cells[0].relay, position=place), "--device") for place in places]
    assert names == [["left"], ["right"]]
    assert (plan.has_two_devices, plan.relay.reached_at) == (True, "left")


def test_unicast_is_an_option_of_both_sides():
    multicast, unicast = plan_of("multicast = [true, false]").cells
    assert "--no-multicast" not in ping_arguments(plan_of(""), multicast, 5.0, None)
    assert "--no-multicast" in ping_arguments(plan_of(""), unicast, 5.0, None)
    assert "--no-multicast" in relay_arguments(plan_of(""), unicast.relay)
    assert unicast.name.endswith("_no-multicast")


@pytest.mark.parametrize(
    ("axes", "more", "word"),
    [
        ("relays = 0", "", "between 1 and 64"),
        ("relays = 20\nhosts = 4", NETWORK, "64"),
        ("relays = 2\nbridge = 'builtin'", "", "bridge"),
        ("relays = 2\noutage = 1\noutage_by = 'relay'", "", "outage"),
        ("pings = 2\ntopics = 2", "", "pings and topics"),
        ("pings = 2\nbridge = 'builtin'", "", "bridge"),
        ("hosts = 2", "", "namespaces"),
        ("hosts = 3", DEVICES, "here 2"),
        ("hosts = 2", "[link]\nrate_mbit_s = 10\n", "[link]"),
        ("hosts = 2", DEVICES.replace("right", "left"), "a name of its own"),
        ("", "[[devices]]\nname = 'left'\n", "ssh"),
        ("relays = 2", "[[flows]]\nname = 'a'\n[[flows]]\nname = 'b'\n[run]\nseconds = 1\n", "flows"),
        ("relays = true", "", "true"),
        ("", "[[devices]]\nssh = 3\n", "[[devices]]"),
        ("", DEVICES + "bridge_port = 0\n", "bridge_port"),
    ],
)
def test_what_cannot_be_recorded_is_one_line(axes, more, word):
    with pytest.raises(OptionError) as error:
        plan_of(axes, more)
    assert word in str(error.value)
    assert "\n" not in str(error.value)


def test_a_relay_of_an_address_is_one_on_its_host():
    with pytest.raises(OptionError, match="hosts in place of relays"):
        parse_plan("[axes]\nbackend = 'socket'\nrelays = 2", "p", "p.toml")


def test_a_person_starts_one_relay():
    with pytest.raises(OptionError, match="--print"):
        plan_of("relays = 2", by_hand=True)

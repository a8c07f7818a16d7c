import re
import signal
import threading
import time
from contextlib import ExitStack, contextmanager

import pytest
from applied_pair import needs_large_buffers
from middlewares import needs
from processes import RunningCommand, wait_for_chunks
from two_devices import needs_devices, two_devices
from waiting import wait_until
from wording import numbers

from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.campaigns.station.emulation import INTERFACE, ip, tc
from dds_trace.recorder.backends.ros2.fastdds_profile import requested_profile
from dds_trace.recorder.backends.ros2.installation import fast_dds
from dds_trace.recorder.choices import Transport
from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace

pytestmark = pytest.mark.middleware

needs_ros2, needs_zenoh = needs("ros2"), needs("zenoh")
PING, RELAY = "192.168.0.10", "192.168.0.20"
MOST_CROSSING_BYTES_S = "100mbit"
"""Rate of the slow link: a burst of 2.8 MB takes it 0.2 s, and its queue has room for half of that."""


@contextmanager
def relaying(start, folder, *options, name="relay", **variables):
    relay = start(
        "dds-record", "--role", "relay", "--no-own-cost", "--out", folder / f"{name}.mcap", *options, **variables
    )
    try:
        relay.wait_for_line("serves domain")
        yield relay
        assert relay.stop(signal.SIGINT).status == 0
    finally:
        relay.clean_up()


@contextmanager
def pinging(start, folder, *options, **variables):
    ping = start("dds-record", "--role", "ping", "--no-own-cost", "--out", folder / "ping.mcap", *options, **variables)
    try:
        yield ping
        done = ping.finish()
        assert done.status in (0, 12), done.stderr
    finally:
        ping.clean_up()


def wait_for_messages(relay):
    wait_for_chunks(relay)
    wait_until(lambda: len(read_trace(relay).events[Stage.T3]) >= 10)


def local(domain_id, *options):
    return ("--domain", domain_id, "--discovery", "localhost", *options)


def found(folder, code):
    return [finding for finding in analyze(folder).findings if finding.code == code]


def received(folder):
    row = analyze(folder).summary.row(0, named=True)
    return row["received"] / row["published"]


def quoted(pattern, finding):
    match = re.search(pattern, finding.action)
    assert match, finding.action
    return match


def record_with_a_stalling_relay(folder, domain_id, *more):
    """The relay stands still for a second or more, twice: a busy machine adds less to it than a doubled depth holds."""
    folder.mkdir()
    options = local(domain_id, *more)

    def sent(stage=Stage.T1):
        return len(read_trace(folder / "ping.mcap").events[stage])

    with (
        relaying(RunningCommand, folder, *options) as relay,
        pinging(RunningCommand, folder, *options, "--rate", 100, "--messages", 100_000) as ping,
    ):
        wait_for_messages(folder / "relay.mcap")
        wait_until(lambda: sent(Stage.T2) >= 50)  # what is lost ahead of the first reply may be of discovery
        for _ in range(2):
            before = sent()
            relay.send_signal(signal.SIGSTOP)
            wait_until(lambda before=before: sent() >= before + 100)
            relay.send_signal(signal.SIGCONT)
            wait_until(lambda before=before: sent() >= before + 150)
        ping.send_signal(signal.SIGINT)


@pytest.mark.thorough
@needs_ros2
def test_a_deeper_history_keeps_what_a_stalled_relay_cannot_take(tmp_path, domain_id):
    record_with_a_stalling_relay(tmp_path / "shallow", domain_id, "--depth", 10)
    (loss,) = found(tmp_path / "shallow", "loss")
    assert "(--depth 10 at 100 Hz)" in loss.what
    depth = quoted(r"give both sides --depth (\d+)", loss)[1]
    record_with_a_stalling_relay(tmp_path / "deep", domain_id, "--depth", depth)
    assert 1 - received(tmp_path / "deep") < (1 - received(tmp_path / "shallow")) / 4


def record_large_ones(folder, domain_id, *options):
    folder.mkdir()
    sides = local(domain_id, "--transport", "udp", *options)
    with (
        relaying(RunningCommand, folder, *sides),
        pinging(RunningCommand, folder, *sides, "--size", "2MB", "--rate", 10, "--messages", 30),
    ):
        pass


@needs_ros2
@needs_large_buffers
def test_tuned_sockets_drop_less(tmp_path, domain_id):
    record_large_ones(tmp_path / "untuned", domain_id)
    overflow = found(tmp_path / "untuned", "udp_buffer_overflow")
    option = quoted(r"record with (--tuned)", overflow[0])[1]
    record_large_ones(tmp_path / "tuned", domain_id, option)
    assert dropped(tmp_path / "tuned") < dropped(tmp_path / "untuned") / 2
    p50 = [analyze(tmp_path / name).summary["rtt_p50_ns"][0] for name in ("untuned", "tuned")]
    assert p50[1] < p50[0]


@needs_ros2
def test_without_the_lifespan_late_messages_are_delivered(tmp_path, domain_id):
    """The relay takes what is younger than the lifespan when it goes on, and all else at once: some always come through."""
    for name, options in (("short", ("--lifespan", "100ms")), ("none", ())):
        record_with_a_stalling_relay(tmp_path / name, domain_id, "--depth", 1000, *options)
    (loss,) = found(tmp_path / "short", "loss")
    assert "older than 100 ms" in loss.what
    assert "-o lifespan" in loss.what
    assert quoted("leave -o lifespan out", loss)
    assert received(tmp_path / "none") > received(tmp_path / "short")


@needs_ros2
def test_a_ping_that_waits_for_both_relays_has_no_late_one(tmp_path, domain_id):
    late, waiting = tmp_path / "late", tmp_path / "waiting"
    sides = local(domain_id, "--reliability", "reliable", "--depth", 1000)
    late.mkdir()
    with ExitStack() as relays:
        relays.enter_context(relaying(RunningCommand, late, *sides, "--device", "a"))
        with pinging(RunningCommand, late, *sides, "--rate", 50, "--messages", 6000) as ping:
            wait_for_messages(late / "relay.mcap")
            relays.enter_context(relaying(RunningCommand, late, *sides, "--device", "b", name="second"))
            wait_for_messages(late / "second.mcap")
            ping.send_signal(signal.SIGINT)
    (joined,) = found(late, "relay_joined_late")
    assert " on b" in joined.where
    assert found(late, "loss") == []
    setting = quoted(r"-o (relays=\d+)", joined)[1]
    waiting.mkdir()
    with pinging(RunningCommand, waiting, *sides, "--rate", 20, "--messages", 40, "-o", setting, "--wait", 60) as ping:
        ping.wait_for_line("waiting for an echo")
        with (
            relaying(RunningCommand, waiting, *sides, "--device", "a"),
            relaying(RunningCommand, waiting, *sides, "--device", "b", name="second"),
        ):
            ping.finish()
    assert found(waiting, "relay_joined_late") == found(waiting, "loss") == []


@contextmanager
def slow_devices(folder):
    """Two devices on a link that is slower than the burst of a message of 2.8 MB."""
    with two_devices(folder, PING, RELAY) as (pair, devices):
        for side in (pair.ping, pair.relay):
            tc("-n", side.namespace, "qdisc", "add", "dev", INTERFACE, "root", "tbf", "rate", MOST_CROSSING_BYTES_S,
               "burst", "32kb", "limit", "1500000")  # fmt: skip
        yield devices


@contextmanager
def stopping_now_and_then(process):
    """Stop a process for 40 ms of each 120: the link brings 500 KB meanwhile, more than a socket takes that nobody asked for."""
    ended = threading.Event()

    def stop_and_go():
        while not ended.wait(0.08):
            process.send_signal(signal.SIGSTOP)
            time.sleep(0.04)
            process.send_signal(signal.SIGCONT)

    thread = threading.Thread(target=stop_and_go)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def record_over(devices, folder, domain_id, *options, size=2_764_800, messages=10, rate=2, busy=False, **variables):
    """Record a pair of these options over the link, with a relay that is kept from reading if `busy`."""
    folder.mkdir()
    sides = ("--domain", domain_id, "--discovery", "subnet", *options)
    sent = ("--size", size, "--rate", rate, "--messages", messages, "--warmup", 1, "--wait", 30)
    with (
        relaying(devices["relay"].start, folder, *sides, **variables) as relay,
        pinging(devices["ping"].start, folder, *sides, *sent, **variables) as ping,
    ):
        if busy:
            with stopping_now_and_then(relay):
                ping.finish()
    return folder


def dropped(folder):
    return sum(numbers(finding.what)[0] for finding in found(folder, "udp_buffer_overflow"))


@pytest.mark.thorough
@needs_devices
@needs_ros2
@needs_large_buffers
def test_tuned_receive_buffers_help_on_a_link_slower_than_the_burst(tmp_path, domain_id):
    with slow_devices(tmp_path) as devices:
        untuned = record_over(devices, tmp_path / "untuned", domain_id, "--transport", "udp", busy=True)
        option = quoted(r"record with (--tuned)", found(untuned, "udp_buffer_overflow")[0])[1]
        tuned = record_over(devices, tmp_path / "tuned", domain_id, option, busy=True)
    assert dropped(tuned) < dropped(untuned) / 2  # a busy machine may stop either process for longer


@pytest.mark.slow  # on a machine that runs other tests the capture misses packets, and then nothing is said of storms
@needs_devices
@needs_ros2
@needs_large_buffers
def test_tuned_receive_buffers_end_a_storm_of_repeats(tmp_path, domain_id):
    with slow_devices(tmp_path) as devices:
        untuned = record_over(devices, tmp_path / "untuned", domain_id, "--wire", "--transport", "udp", busy=True)
        (storm,) = found(untuned, "retransmission_storm")
        option = quoted(r"give the sockets larger ones \((--tuned)", storm)[1]
        tuned = record_over(devices, tmp_path / "tuned", domain_id, "--wire", option, busy=True)
    assert received(tuned) >= received(untuned)
    assert found(tuned, "fragments_lost") == []
    before, after = analyze(untuned), analyze(tuned)
    assert after.summary["rtt_p50_ns"][0] < before.summary["rtt_p50_ns"][0]
    assert after.details.wire["again_bytes_share"][0] < before.details.wire["again_bytes_share"][0]


@pytest.mark.thorough
@needs_devices
@needs_ros2
@needs_large_buffers
def test_without_a_larger_send_buffer_the_own_queue_takes_the_burst(tmp_path, domain_id):
    only_receive = requested_profile(Transport.UDP, tuned=True, is_local=False)
    both = only_receive.replace("<receiveBuffer", "<sendBufferSize>4000000</sendBufferSize><receiveBuffer")
    with slow_devices(tmp_path) as devices:
        folders = []
        for name, text in (("both", both), ("receive", only_receive)):
            path = tmp_path / f"{name}.xml"
            path.write_text(text)
            profile = {fast_dds().profile_variables[0]: str(path)}
            folders.append(
                record_over(devices, tmp_path / name, domain_id, size=1_400_000, rate=10, messages=40, **profile)
            )
    unsent = [
        [each for each in found(folder, "fragments_lost") if "could not be sent" in each.what] for folder in folders
    ]
    assert quoted("leave larger send buffers out", unsent[0][0])
    assert unsent[1] == []


@pytest.mark.thorough
@needs_devices
@needs_zenoh
def test_zenoh_waits_for_a_full_link_when_it_is_reliable(tmp_path, domain_id):
    with slow_devices(tmp_path) as devices:
        options = ("--backend", "zenoh", "--reliability")
        peer = ("--peer", RELAY)
        kept = {}
        for reliability in ("best_effort", "reliable"):
            folder = tmp_path / reliability
            folder.mkdir()
            sides = ("--domain", domain_id, "--discovery", "subnet", *options, reliability)
            with (
                relaying(devices["relay"].start, folder, *sides),
                pinging(devices["ping"].start, folder, *sides, *peer, "--size", "1MB", "--rate", 20, "--messages", 60),
            ):
                pass
            kept[reliability] = received(folder)
            if reliability == "best_effort":
                (loss,) = found(folder, "loss")
                assert "drops best-effort messages in the sender" in loss.what
                assert quoted("--reliability reliable", loss)
    assert kept["reliable"] > kept["best_effort"]


@pytest.mark.thorough
@needs_devices
@needs_ros2
def test_a_message_crosses_one_network_if_one_is_named(tmp_path, domain_id):
    with two_devices(tmp_path, PING, RELAY) as (pair, devices):
        ip("-n", pair.ping.namespace, "link", "add", "second0", "type", "veth",
           "peer", "name", "second0", "netns", pair.relay.namespace)  # fmt: skip
        for side, address in ((pair.ping, "172.20.0.10"), (pair.relay, "172.20.0.20")):
            ip("-n", side.namespace, "address", "add", f"{address}/24", "dev", "second0")
            ip("-n", side.namespace, "link", "set", "second0", "up")
        message = {"size": 100_000, "messages": 100, "rate": 50}
        both = record_over(devices, tmp_path / "both", domain_id, "--transport", "udp", **message)
        networks = found(both, "several_networks")
        assert f"Each of {INTERFACE} and second0" in networks[0].what
        assert quoted("interfaceWhiteList in a Fast DDS profile", networks[0])
        named = "<interfaceWhiteList><address>{}</address></interfaceWhiteList></transport_descriptor>"
        text = requested_profile(Transport.UDP, tuned=True, is_local=False)
        profiles = {}
        for name, address in (("ping", PING), ("relay", RELAY)):
            profiles[name] = tmp_path / f"{name}.xml"
            profiles[name].write_text(text.replace("</transport_descriptor>", named.format(address), 1))
        one = tmp_path / "one"
        one.mkdir()
        sides = ("--domain", domain_id, "--discovery", "subnet")
        sent = ("--size", 100_000, "--rate", 50, "--messages", 100)
        variable = fast_dds().profile_variables[0]
        with (
            relaying(devices["relay"].start, one, *sides, **{variable: str(profiles["relay"])}),
            pinging(devices["ping"].start, one, *sides, *sent, **{variable: str(profiles["ping"])}),
        ):
            pass
    assert found(one, "several_networks") == []
    assert received(one) > 0.5

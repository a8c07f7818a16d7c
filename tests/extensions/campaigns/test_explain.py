import pytest

from dds_trace.base.errors import OptionError
from dds_trace.extensions.campaigns import explain as module
from dds_trace.extensions.campaigns.explain import explain_rates, explain_size
from dds_trace.extensions.campaigns.plan.plan import Order
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.plan.schedule import schedule


def plan(axes, more=""):
    return parse_plan(f"{more}\n[axes]\n{axes}\n", "p", "p.toml")


@pytest.fixture
def sleepy(monkeypatch, tmp_path):
    driver = tmp_path / "current_driver"
    driver.write_text("acpi_idle\n")
    monkeypatch.setattr(module, "IDLE_DRIVER", driver)
    monkeypatch.setattr(module, "DMA_LATENCY", str(driver))
    return driver


def names(pair):
    return tuple(cell.name for cell in pair)


@pytest.mark.usefixtures("sleepy")
def test_rates_are_the_fastest_and_the_slowest_under_each_condition():
    made = explain_rates(plan('backend = "cyclonedds"\nrate = [10, 50, 500]'))
    (setup,) = made.setups
    fast, slow = "cyclonedds_same_binary_500Hz", "cyclonedds_same_binary_10Hz"
    assert {key: names(pair) for key, pair in setup.pairs.items()} == {
        "as is": (fast, slow),
        "machine": ("socket_same_binary_500Hz", "socket_same_binary_10Hz"),
        "awake": (f"{fast}_awake", f"{slow}_awake"),
        "dma_latency": (f"{fast}_dma-latency", f"{slow}_dma-latency"),
        "realtime": (f"{fast}_realtime-50", f"{slow}_realtime-50"),
        "wake": (fast, f"{slow}_wake-5"),
    }
    assert (made.plan.run.repeats, made.plan.run.order, made.plan.name) == (5, Order.ALTERNATING, "p-rates")
    assert sum(len(group.cells) for group in schedule(made.plan)) == 5 * 11
    assert made.left_out == {}


def test_what_the_machine_refuses_is_left_out_with_its_reason(sleepy):
    sleepy.write_text("none\n")
    made = explain_rates(plan('backend = "socket"\nrate = [250, 500]'))
    assert made.left_out.keys() == {"dma_latency", "wake"}
    assert made.setups[0].pairs.keys() == {"as is", "awake", "realtime"}  # sockets are their own control
    sleepy.unlink()
    without = explain_rates(plan('backend = "socket"\nrate = [10, 500]'))
    assert without.left_out.keys() == {"dma_latency"}


@pytest.mark.usefixtures("sleepy")
def test_the_vendor_without_the_client_library_is_measured_where_it_is_installed(monkeypatch):
    backend = type("B", (), {"find_installed": staticmethod(lambda: [None])})
    monkeypatch.setattr(module, "load_backend", lambda _: backend)
    two = 'backend = "ros2"\nrmw = ["rmw_cyclonedds_cpp", "rmw_fastrtps_cpp"]\nexecutor = "single"\nrate = [10, 500]'
    cyclone, fast = explain_rates(plan(two)).setups
    assert names(cyclone.pairs["native"]) == ("cyclonedds_same_binary_500Hz", "cyclonedds_same_binary_10Hz")
    assert "native" not in fast.pairs


def test_a_size_is_measured_on_both_sides_with_one_factor_varied():
    link = "[link]\nrate_mbit_s = 100\nqueue_ms = 5\n[run]\nrepeats = 3\n"
    messages = '[[matrix]]\nsize = "1KB"\nrate = 20\n[[matrix]]\ndata = "imu"\nrate = 20'
    made = explain_size(plan(f'backend = "cyclonedds"\n{messages}', link), "400KB")
    (setup,) = made.setups
    small, large = setup.pairs["as is"]
    assert (small.size, large.size) == (300_000, 500_000)
    assert setup.pairs.keys() == {"as is", "buffer", "fragment", "history", "queue"}
    assert made.left_out.keys() == {"imu", "segment"}
    for key, axis, value in (("fragment", "fragment", 60_000), ("history", "depth", 1), ("queue", "queue", 200)):
        assert [getattr(cell, axis) for cell in setup.pairs[key]] == [value, value]
        assert [cell.size for cell in setup.pairs[key]] == [300_000, 500_000]
    assert made.plan.run.repeats == 3


def test_each_transport_has_its_factors():
    made = explain_size(plan('backend = "ros2"\ntransport = ["udp", "shm"]\nfragment = ""\ndepth = 1'), "1KB..2KB")
    udp, shm = made.setups
    assert udp.pairs.keys() == {"as is", "buffer", "fragment", "history"}
    assert shm.pairs.keys() == {"as is", "segment", "history"}
    assert udp.pairs["fragment"][0].fragment == 1400
    assert udp.pairs["history"][0].depth == 100


@pytest.mark.parametrize(
    ("call", "word"),
    [
        (lambda: explain_rates(plan("rate = 10")), "two rates"),
        (lambda: explain_rates(plan('rate = [10, "max"]', "[run]\nseconds = 2")), "two rates"),
        (lambda: explain_rates(plan('rate = [10, 20]\nload = "cpu"')), "varies"),
        (lambda: explain_size(plan("rate = 10"), "9KB..3KB"), "below"),
        (lambda: explain_size(plan("rate = 10"), "large"), "SIZE"),
        (lambda: explain_size(plan('data = "imu"'), "9KB"), "binary or string"),
        (lambda: explain_size(plan("outage = 2", "[network]\nnamespaces = true"), "9KB"), "outages"),
    ],
)
def test_what_cannot_be_explained_is_refused_in_one_line(call, word):
    with pytest.raises(OptionError) as error:
        call()
    assert word in str(error.value)
    assert "\n" not in str(error.value)

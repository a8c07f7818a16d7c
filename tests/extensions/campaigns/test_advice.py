import json
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest
from processes import executed

from dds_trace.extensions.campaigns.advice import bundles, variables_of, write_bundles
from dds_trace.extensions.campaigns.plan.link import Link
from dds_trace.recorder.backends.base import has_package

VENDORS = ("fastdds", "cyclonedds", "zenoh")
SLOW = 1_000_000, Link("slow", rate_mbit_s=20, delay_ms=5)


@pytest.mark.parametrize("vendor", VENDORS)
def test_only_a_link_with_a_rate_is_paced(vendor):
    paced = {"fastdds": "paced", "cyclonedds": "paced-small-packets", "zenoh": "short-queue"}[vendor]
    assert paced in bundles(vendor, *SLOW)
    assert paced not in bundles(vendor, 1_000_000, None)


def test_one_period_of_fast_dds_lets_the_largest_datagram_through_at_any_rate():
    for rate in (0.5, 20, 1000):
        tree = ET.fromstring(bundles("fastdds", 1_000_000, Link("any", rate_mbit_s=rate))["paced"])
        numbers = {node.tag.rpartition("}")[2]: node.text for node in tree.iter()}
        assert int(numbers["max_bytes_per_period"]) >= 65_000
        share = int(numbers["max_bytes_per_period"]) * 8000 / int(numbers["period_ms"]) / (rate * 1e6)
        assert share == pytest.approx(0.8, rel=0.01)


def test_an_unknown_vendor_has_none():
    assert bundles("socket", *SLOW) == {}


def test_the_files_and_what_loads_them(tmp_path):
    for vendor in VENDORS:
        paths = write_bundles(vendor, bundles(vendor, *SLOW), tmp_path / vendor)
        assert [path.stem for path in paths] == list(bundles(vendor, *SLOW))
        assert any(str(paths[0]) in value for value in variables_of(vendor, paths[0]).values())
    override = variables_of("zenoh", tmp_path / "zenoh" / "unbatched.json5")["ZENOH_CONFIG_OVERRIDE"]
    assert override == "transport/link/tx/queue/batching/enabled=false"


def test_cyclone_dds_accepts_its_bundles():
    if not has_package("cyclonedds"):
        pytest.skip("cyclonedds is not installed")
    code = "import sys, json; from cyclonedds.domain import Domain\nfor n, text in enumerate(json.load(sys.stdin)): Domain(100 + n, text)"
    texts = [text.partition("?>")[2] for text in bundles("cyclonedds", *SLOW).values()]
    done = executed([sys.executable, "-c", code], input=json.dumps(texts))
    assert (done.returncode, done.stderr) == (0, "")


def test_zenoh_accepts_its_bundles():
    zenoh = pytest.importorskip("zenoh")
    for text in bundles("zenoh", *SLOW).values():
        zenoh.Config.from_json5(text)


def test_fast_dds_accepts_the_bundle_with_every_key(tmp_path):
    if not has_package("rclpy"):
        pytest.skip("rclpy is not installed")
    (path,) = write_bundles(
        "fastdds", {name: bundles("fastdds", *SLOW)[name] for name in ["paced-small-packets"]}, tmp_path
    )
    program = Path(sys.executable).with_name("dds-record")
    options = ["--role", "relay", "--backend", "ros2", "--configuration", path, "--discovery", "localhost", "--check"]
    done = executed([program, *options, "--out", tmp_path / "x.mcap"])
    assert done.returncode == 0, done.stderr


def test_a_plan_may_list_files_of_settings():
    from dds_trace.extensions.campaigns.plan.plan_file import parse_plan

    text = '[axes]\nbackend = "zenoh"\nconfiguration = ["", "a/fast.json5"]'
    plan = parse_plan(text, "x", "x.toml")
    assert [cell.configuration for cell in plan.cells] == [None, "a/fast.json5"]
    assert plan.cells[1].name.endswith("_fast")

"""The `connext` backend: everything that runs without a licence, and the rest where there is one."""

import os

import pytest
from backend_pairs import all_data_types
from processes import run

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.recorder.backends import connext, open_node
from dds_trace.recorder.backends.dds_types import DDS_TYPES
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery, Transport
from dds_trace.recorder.payloads import data_types
from dds_trace.tracefile.format.descriptions import Qos

dds = pytest.importorskip("rti.connextdds", reason="no rti.connext here")

needs_licence = pytest.mark.skipif(
    not os.environ.get("RTI_LICENSE_FILE"), reason="RTI Connext starts with a licence alone (RTI_LICENSE_FILE)"
)


def without_a_licence(monkeypatch, folder):
    for name in ("RTI_LICENSE_FILE", "NDDSHOME", "CONNEXTDDS_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(folder)  # RTI also looks for rti_license.dat in the working folder


def test_without_a_licence_a_line_says_what_to_set(domain_id, tmp_path, monkeypatch):
    without_a_licence(monkeypatch, tmp_path)
    with pytest.raises(BackendUnavailableError, match="set RTI_LICENSE_FILE to the path of"):
        open_node("connext", NodeOptions(domain_id, discovery=Discovery.LOCALHOST))


def test_without_a_licence_the_command_ends_with_that_line(domain_id, tmp_path, monkeypatch):
    without_a_licence(monkeypatch, tmp_path)
    done = run(
        *("dds-record", "--role", "relay", "--backend", "connext", "--domain", domain_id),
        *("--out", tmp_path / "relay.mcap"),
    )
    assert done.status == BackendUnavailableError.exit_code
    assert "RTI Connext" in done.stderr
    assert "it needs a licence" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "relay.mcap").exists()


@pytest.mark.parametrize("data_type", data_types().values(), ids=lambda data_type: data_type.name)
def test_messages_of_ours_are_messages_to_connext(data_type):
    """DynamicData takes the serialized message, and Connext's own reading of it finds its fields."""
    message = data_type.make(None, 1).messages[0].data
    kind = connext._dynamic_type(dds, data_type.type_name)
    sample = dds.DynamicData(kind)
    sample.set_cdr_buffer(message)
    assert bytes(sample.get_cdr_buffer()) == message
    read = dds.DynamicData(kind)
    read.from_cdr_buffer(dds.Uint8Seq(message))
    stamp = read["data"][:46] if data_type.name == "string" else read["header.frame_id"]
    assert stamp.startswith("dt1:")


@pytest.mark.parametrize("type_name", DDS_TYPES)
def test_every_known_type_can_be_made(type_name):
    made = connext._dynamic_type(dds, type_name)
    assert made.name.replace("::", "/").replace("/dds_", "").rstrip("_") == type_name


@pytest.mark.parametrize("qos", [Qos(), Qos("best_effort", "transient_local", "keep_all"), Qos(depth=7)], ids=str)
@pytest.mark.parametrize("kind", ["DataWriterQos", "DataReaderQos"])
def test_quality_of_service_is_ours(qos, kind):
    kept = connext._fill(getattr(dds, kind)(), qos)
    assert connext._policy(kept.reliability.kind) == qos.reliability
    assert connext._policy(kept.durability.kind) == qos.durability
    assert connext._policy(kept.history.kind) == qos.history
    if qos.history == "keep_last":
        assert kept.history.depth == qos.depth


def test_deadline_and_lifespan_are_ours_and_are_read_back():
    asked = Qos(extra={"deadline_ns": 20_000_000, "lifespan_ns": 1_500_000_001})
    writer, reader = connext._fill(dds.DataWriterQos(), asked), connext._fill(dds.DataReaderQos(), asked)
    for kept in (writer, reader):
        assert connext._qos(kept) == Qos("reliable", "volatile", "", 0, asked.extra)
    without = connext._fill(dds.DataWriterQos(), Qos())
    assert connext._qos(without).extra == {}  # Connext's word for no end is 2^31 - 1 s and as many ns


def test_options_without_a_meaning_are_refused():
    with pytest.raises(OptionError, match="only has default"):
        open_node("connext", NodeOptions(transport=Transport.SHM))
    with pytest.raises(OptionError, match="rather"):
        connext._fill(dds.DataWriterQos(), Qos("rather"))


@needs_licence
@pytest.mark.middleware
@pytest.mark.parametrize("more", [(), ("--tuned",)], ids=["default", "tuned"])
def test_all_data_types_go_there_and_back(domain_id, tmp_path, more):
    here, there = all_data_types(domain_id, tmp_path, "connext", "connext", *more, has_source=True)
    assert (here.vendor, there.vendor) == ("connext", "connext")


@needs_licence
@pytest.mark.middleware
@pytest.mark.parametrize("pair", [("connext", "ros2"), ("ros2", "connext"), ("connext", "cyclonedds")])
def test_all_data_types_cross(domain_id, tmp_path, pair):
    all_data_types(domain_id, tmp_path, *pair, has_source=True)

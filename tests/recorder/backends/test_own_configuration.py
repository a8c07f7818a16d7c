import os
import re
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest
from processes import executed

from dds_trace.base.errors import OptionError
from dds_trace.recorder.backends import load_backend
from dds_trace.recorder.backends.base import has_package
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery
from dds_trace.recorder.host.environment import ConfigurationVariable, MiddlewareEnvironment, watched_configuration

PARTICIPANT = 'participant profile_name="x" is_default_profile="true"'
FASTDDS = (
    '<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>'
    f"<{PARTICIPANT}><rtps><{{}}>1</{{}}></rtps></participant></profiles></dds>"
)
FILES = {
    "cyclonedds": (
        "own.xml",
        "<CycloneDDS><Domain><General><Colour>red</Colour></General></Domain></CycloneDDS>",
        "Colour",
    ),
    "zenoh": ("own.json5", "{transport: {link: {tx: {queu: {}}}}}", "queu"),
    "ros2": ("own.xml", FASTDDS.format("colour", "colour"), "colour"),
}


@pytest.mark.parametrize(
    ("printed", "words"),
    [
        (
            "1.2 [7] python: config: //CycloneDDS/Domain/General: Colour: unknown element (file:///own.xml line 3)\n",
            "//CycloneDDS/Domain/General: Colour: unknown element (file:///own.xml line 3)",
        ),
        (
            "\x1b[31;1m[\x1b[37;1mXMLPARSER\x1b[31;1m Error] \x1b[37mInvalid element found into 'rtps'. Name: colour\x1b[34;1m -> Function fill\n",
            "Invalid element found into 'rtps'. Name: colour",
        ),
        ("1.2 [7] python: config: //CycloneDDS/Domain/Id: setting: deprecated\n", None),
    ],
)
def test_what_a_middleware_prints_of_its_configuration(printed, words, monkeypatch):
    monkeypatch.setenv("OWN", "<own/>")
    environment = MiddlewareEnvironment(configuration=(ConfigurationVariable("OWN"),))
    refused = nullcontext() if words is None else pytest.raises(OptionError, match=re.escape(f": {words}; correct"))
    with refused, watched_configuration("it", environment):
        os.write(1, printed.encode())


@pytest.mark.parametrize("backend", FILES)
def test_an_unknown_key_ends_the_start_in_one_line(backend, tmp_path):
    if not has_package({"ros2": "rclpy"}.get(backend, backend)):
        pytest.skip(f"{backend} is not installed")
    name, text, key = FILES[backend]
    (tmp_path / name).write_text(text)
    program = Path(sys.executable).with_name("dds-record")
    options = ["--role", "relay", "--backend", backend, "--configuration", name, "--discovery", "localhost", "--check"]
    done = executed([program, *options, "--out", "x.mcap"], cwd=tmp_path)
    assert done.returncode == 2
    assert key in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_the_variables_of_each_middleware(tmp_path):
    path = tmp_path / "own"
    path.write_text("<flow_controller_name>")
    options = NodeOptions(configuration=path)
    assert load_backend("cyclonedds").own_variables(options) == {"CYCLONEDDS_URI": f"file://{path}"}
    assert load_backend("zenoh").own_variables(options) == {"ZENOH_CONFIG": str(path)}
    fastdds = load_backend("ros2").variables_of("rmw_fastrtps_cpp", path)
    assert fastdds["RMW_FASTRTPS_PUBLICATION_MODE"] == "ASYNCHRONOUS"
    assert str(path) in fastdds.values()
    assert load_backend("ros2").variables_of("rmw_zenoh_cpp", path) == {"ZENOH_SESSION_CONFIG_URI": str(path)}
    assert load_backend("socket").own_variables(NodeOptions()) == {}


def test_a_file_that_is_missing_or_of_no_use_is_refused(tmp_path):
    with pytest.raises(OptionError, match="--configuration"):
        load_backend("zenoh").check(NodeOptions(configuration=tmp_path / "none.json5"))
    (tmp_path / "own").touch()
    for backend, rmw in (("socket", None), ("ros2", "rmw_connextdds")):
        with pytest.raises(OptionError, match="--configuration"):
            load_backend(backend).check(NodeOptions(configuration=tmp_path / "own", rmw=rmw))


def test_zenoh_adds_its_part_to_the_users_file(tmp_path, monkeypatch):
    zenoh = pytest.importorskip("zenoh")
    from dds_trace.recorder.backends.zenoh import _added_to_own, zenoh_configuration

    path = tmp_path / "own.json5"
    path.write_text("{mode: 'client', transport: {link: {tx: {batch_size: 1400}}, unicast: {max_links: 3}}}")
    monkeypatch.setenv("ZENOH_CONFIG", str(path))
    options = NodeOptions(discovery=Discovery.LOCALHOST, listens=True)
    added = _added_to_own(zenoh_configuration(options))
    assert added.get_json("mode") == '"peer"'
    assert added.get_json("transport/link/tx/batch_size") == "1400"
    assert added.get_json("transport/unicast/max_links") == "3"
    assert "tcp/127.0.0.1" in added.get_json("listen/endpoints")
    assert zenoh.Config().get_json("transport/link/tx/batch_size") != "1400"


@pytest.mark.skipif(not has_package("zenoh"), reason="no zenoh here")
@pytest.mark.parametrize(
    ("name", "text"), [("a.json5", "root:SECRET:x\n"), ("a.json5", '{"mode": "SECRET"}'), ("a.yaml", 'a: "SECRET\n')]
)
def test_zenoh_prints_nothing_of_a_file_that_is_no_configuration(tmp_path, name, text, monkeypatch):
    (tmp_path / name).write_text(text)
    monkeypatch.setenv("ZENOH_CONFIG", str(tmp_path / name))
    with pytest.raises(OptionError, match=name) as caught:
        load_backend("zenoh").open_node(NodeOptions(domain_id=3, discovery=Discovery.LOCALHOST))
    assert "SECRET" not in str(caught.value)

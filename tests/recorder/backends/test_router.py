"""The router of rmw_zenoh: found, started, missing. The program here is a stand-in, no RMW: nothing of zenoh is proven by it."""

import os
import re
import socket
import sys

import pytest
from processes import own_port

from dds_trace.base.errors import BackendUnavailableError
from dds_trace.recorder.applied import vendors
from dds_trace.recorder.applied.vendors import ROS_MIDDLEWARES
from dds_trace.recorder.backends.ros2.installation import open_router
from dds_trace.recorder.choices import Discovery

RMW = "rmw_zenoh_cpp"
LISTENING = f"""#!{sys.executable}
import os, re, signal, socket, sys
port = int(re.search(r'listen/endpoints=\\["tcp/localhost:(\\d+)"\\]', os.environ["ZENOH_CONFIG_OVERRIDE"])[1])
listener = socket.create_server(("localhost", port))
signal.sigwait([signal.SIGTERM])
"""


@pytest.fixture
def port(monkeypatch, domain_id):
    number = own_port(domain_id)
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", f'connect/endpoints=["tcp/localhost:{number}"]')
    zenoh = vendors.ROS_MIDDLEWARES[RMW]
    monkeypatch.setitem(
        ROS_MIDDLEWARES, RMW, type(zenoh)(zenoh.vendor, zenoh.label, (), router=zenoh.router, router_port=number)
    )
    return number


@pytest.fixture
def installed(tmp_path, monkeypatch):
    program = tmp_path / "lib" / RMW / "rmw_zenohd"
    program.parent.mkdir(parents=True)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")

    def install(text):
        program.write_text(text)
        program.chmod(0o755)
        return program

    return install


def test_other_middlewares_need_none():
    for rmw in [*ROS_MIDDLEWARES, "rmw_of_somebody"]:
        if rmw != RMW:
            assert open_router(rmw, Discovery.SUBNET).settings == {}


def test_one_that_listens_is_used_and_left_alone(port):
    with socket.create_server(("localhost", port)) as listener:
        for discovery in Discovery:
            router = open_router(RMW, discovery)
            assert (router.settings, router.process) == ({"router": "was running"}, None)
            router.close()
        assert listener.fileno() > 0


def test_on_this_machine_it_is_started_and_ended_with_the_node(port, installed):
    installed(LISTENING)
    router = open_router(RMW, Discovery.LOCALHOST)
    assert router.settings == {"router": "started"}
    pid = router.process.pid
    assert open_router(RMW, Discovery.LOCALHOST).settings == {"router": "was running"}  # of a second node
    router.close()
    router.close()
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("localhost", port))


@pytest.mark.parametrize(
    ("discovery", "text", "said"),
    [
        (Discovery.SUBNET, LISTENING, "start it with `ros2 run rmw_zenoh_cpp rmw_zenohd`, on each device"),
        (Discovery.LOCALHOST, None, "rmw_zenohd is not installed here"),
        (Discovery.LOCALHOST, "#!/bin/sh\nexit 3\n", "rmw_zenohd ended at once"),
        (Discovery.LOCALHOST, "#!/bin/sh\nexec sleep 60\n", "does not listen within 0.3 s"),
    ],
)
def test_without_one_a_line_says_what_to_start(port, installed, discovery, text, said):
    if text is not None:
        installed(text)
    where = re.escape(f"rmw_zenoh_cpp needs its router, and none listens at localhost:{port}; ")
    with pytest.raises(BackendUnavailableError, match=f"^{where}.*{re.escape(said)}"):
        open_router(RMW, discovery, patience_s=0.3)

import hashlib
import json
import platform
import socket

from dds_trace.recorder.backends import load_backends
from dds_trace.recorder.backends.ros2.installation import fast_dds
from dds_trace.recorder.host import fingerprint as host
from dds_trace.recorder.host.environment import ConfigurationVariable, MiddlewareEnvironment, join_environments
from dds_trace.recorder.host.fingerprint import host_fingerprint, read_text

VARIABLE = fast_dds().profile_variables[0]
ENVIRONMENT = join_environments(backend.environment for backend in load_backends())


def test_every_middleware_is_looked_at_and_each_variable_once():
    names = [variable.name for variable in ENVIRONMENT.configuration]
    assert {fast_dds().profile_variables[0], "CYCLONEDDS_URI", "NDDS_QOS_PROFILES", "ZENOH_CONFIG"} < set(names)
    one = MiddlewareEnvironment(("A",), (ConfigurationVariable("B", ","),), ("c.xml",))
    two = MiddlewareEnvironment(("A", "D"), (ConfigurationVariable("B", ","),), ("c.xml", "e.xml"))
    assert join_environments([one, two]) == MiddlewareEnvironment(
        ("A", "D"), (ConfigurationVariable("B", ","),), ("c.xml", "e.xml")
    )


def test_settings_are_kept_whole_and_only_if_they_are_set():
    variables = {"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp", "HOME": "/home/somebody"}
    assert ENVIRONMENT.read_settings(variables) == {"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}


def test_configuration_files_are_hashed_and_their_folders_left_out(tmp_path):
    profiles = tmp_path / "profiles.xml"
    profiles.write_text("<profiles/>")
    found = ENVIRONMENT.hash_configuration(
        {
            VARIABLE: str(profiles),
            "CYCLONEDDS_URI": f"file://{profiles},{tmp_path}/missing.xml",
            "NDDS_QOS_PROFILES": "",
        },
        tmp_path,
    )
    digest = hashlib.sha256(b"<profiles/>").hexdigest()
    assert found == {
        VARIABLE: [{"name": "profiles.xml", "sha256": digest}],
        "CYCLONEDDS_URI": [{"name": "profiles.xml", "sha256": digest}, {"name": "missing.xml", "sha256": None}],
    }


def test_inline_configuration_is_one_entry_even_with_the_separator_inside(tmp_path):
    inline = "<CycloneDDS><Domain><General><Interfaces>a,b</Interfaces></General></Domain></CycloneDDS>"
    found = ENVIRONMENT.hash_configuration({"CYCLONEDDS_URI": inline}, tmp_path)
    assert found == {"CYCLONEDDS_URI": [{"name": "inline", "sha256": hashlib.sha256(inline.encode()).hexdigest()}]}


def test_profile_in_the_working_directory_counts_though_no_variable_names_it(tmp_path):
    file = fast_dds().profile_file
    (tmp_path / file).write_text("x")
    assert list(ENVIRONMENT.hash_configuration({}, tmp_path)) == [f"./{file}"]


# As Linux prints it; columns are status, quality, level, noise, then discarded packets.
WIRELESS = """\
Inter-| sta-|   Quality        |   Discarded packets               | Missed | WE
 face | tus | link level noise |  nwid  crypt   frag  retry   misc | beacon | 22
 wlan0: 0000   54.  -56.  -256        0      0      0      0      7        0
"""

PI_CPUINFO = """\
processor\t: 0
CPU part\t: 0xd08

Hardware\t: BCM2835
Serial\t\t: 10000000deadbeef
"""


def test_fingerprint_is_json_with_every_field_of_the_trace_format():
    fingerprint = json.loads(json.dumps(host_fingerprint({"rclpy": "7.1.6"})))
    assert fingerprint["versions"] == {"rclpy": "7.1.6"}
    assert fingerprint["kernel"] == platform.release()
    assert fingerprint["python"].endswith(platform.python_version())
    assert fingerprint["memory_bytes"] > 0
    assert fingerprint["cpu_cores"] >= 1
    assert fingerprint["cpu_model"]
    assert fingerprint["mtu"]["lo"] > 0
    assert {"cpu_governor", "socket_buffers", "clock_source", "kernel_realtime", "container", "wifi"} <= set(
        fingerprint
    )


def test_how_long_fragments_wait_and_in_how_many_bytes():
    reassembly = host_fingerprint()["reassembly"]
    assert reassembly["net.ipv4.ipfrag_time"] == int(read_text("/proc/sys/net/ipv4/ipfrag_time"))
    assert reassembly["net.ipv4.ipfrag_high_thresh"] > 0
    assert all(name.startswith("net.ipv4.ipfrag_") for name in reassembly)


def test_fingerprint_names_no_host():
    assert f'"{socket.gethostname()}"' not in json.dumps(host_fingerprint())


def test_no_file_under_proc_or_sys_is_needed(monkeypatch):
    monkeypatch.setattr(host, "read_text", lambda _path: None)
    fingerprint = host_fingerprint()
    assert fingerprint["socket_buffers"] == {}
    assert fingerprint["wifi"] == {}
    assert fingerprint["clock_source"] is None


def test_board_without_model_name_keeps_its_serial_number_to_itself(monkeypatch):
    monkeypatch.setattr(host, "read_text", {"/proc/cpuinfo": PI_CPUINFO}.get)
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    text = json.dumps(host_fingerprint())
    assert "aarch64 part 0xd08" in text
    assert "deadbeef" not in text


def test_wifi_signal_of_each_interface(monkeypatch):
    monkeypatch.setattr(host, "read_text", {"/proc/net/wireless": WIRELESS.strip()}.get)
    assert host.wifi_signals() == {"wlan0": {"link_quality": 54.0, "signal_dbm": -56.0, "noise_dbm": -256.0}}


def test_read_text_of_nothing_is_none(tmp_path):
    assert read_text(tmp_path / "none") is None
    assert read_text(tmp_path) is None

from __future__ import annotations

import hashlib

from dds_trace.recorder.backends import load_backends
from dds_trace.recorder.host.environment import ConfigurationVariable, MiddlewareEnvironment, join_environments

ENVIRONMENT = join_environments(backend.environment for backend in load_backends())


def test_every_middleware_is_looked_at_and_each_variable_once():
    names = [variable.name for variable in ENVIRONMENT.configuration]
    assert {"FASTDDS_DEFAULT_PROFILES_FILE", "CYCLONEDDS_URI", "NDDS_QOS_PROFILES", "ZENOH_CONFIG"} < set(names)
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
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(profiles),
            "CYCLONEDDS_URI": f"file://{profiles},{tmp_path}/missing.xml",
            "NDDS_QOS_PROFILES": "",
        },
        tmp_path,
    )
    digest = hashlib.sha256(b"<profiles/>").hexdigest()
    assert found == {
        "FASTRTPS_DEFAULT_PROFILES_FILE": [{"name": "profiles.xml", "sha256": digest}],
        "CYCLONEDDS_URI": [{"name": "profiles.xml", "sha256": digest}, {"name": "missing.xml", "sha256": None}],
    }


def test_inline_configuration_is_one_entry_even_with_the_separator_inside(tmp_path):
    inline = "<CycloneDDS><Domain><General><Interfaces>a,b</Interfaces></General></Domain></CycloneDDS>"
    found = ENVIRONMENT.hash_configuration({"CYCLONEDDS_URI": inline}, tmp_path)
    assert found == {"CYCLONEDDS_URI": [{"name": "inline", "sha256": hashlib.sha256(inline.encode()).hexdigest()}]}


def test_profile_in_the_working_directory_counts_though_no_variable_names_it(tmp_path):
    (tmp_path / "DEFAULT_FASTRTPS_PROFILES.xml").write_text("x")
    assert list(ENVIRONMENT.hash_configuration({}, tmp_path)) == ["./DEFAULT_FASTRTPS_PROFILES.xml"]

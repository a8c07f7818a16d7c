import re
from importlib import metadata
from pathlib import Path

import pytest

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.recorder.applied.vendors import ROS_MIDDLEWARES, VENDORS, ros_middleware
from dds_trace.recorder.backends import load_backend
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.backends.ros2 import fastdds_profile, installation
from dds_trace.recorder.choices import Discovery, Transport
from dds_trace.tracefile.format.descriptions import Qos

STATUS = """Package: ros-jazzy-rmw-zenoh-cpp-dbgsym
Status: install ok installed
Version: 9.9.9-1

Package: ros-jazzy-rmw-zenoh-cpp
Status: install ok installed
Priority: optional
Version: 0.2.6-1noble.20250701.012345

Package: bash
Version: 5.2
"""


def test_a_type_that_an_installed_package_lacks_needs_another_name_and_no_installation(tmp_path, monkeypatch):
    (tmp_path / "made_msgs/msg").mkdir(parents=True)
    (tmp_path / "made_msgs/__init__.py").touch()
    (tmp_path / "made_msgs/made_msgs_s__rosidl_typesupport_c.so").touch()
    (tmp_path / "made_msgs/msg/__init__.py").write_text("class Image: pass")
    monkeypatch.syspath_prepend(tmp_path)
    assert installation.message_class("made_msgs/msg/Image").__name__ == "Image"
    with pytest.raises(BackendUnavailableError, match="has no msg/Imge; did you mean 'Image'"):
        installation.message_class("made_msgs/msg/Imge")


def test_each_vendor_of_an_rmw_is_in_the_table_of_vendors():
    assert {known.vendor for known in ROS_MIDDLEWARES.values()} <= set(VENDORS)
    own = ros_middleware("rmw_of_somebody_cpp")
    assert (own.vendor, own.packages, own.router) == ("of_somebody", ("rmw_of_somebody_cpp",), "")


def test_a_version_is_found_wherever_the_installation_tells_it(tmp_path, monkeypatch):
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    monkeypatch.setenv("ROS_DISTRO", "jazzy")
    monkeypatch.setattr(installation, "DPKG_STATUS", tmp_path / "status")
    package = "rmw_zenoh_cpp"
    assert installation.package_version(package) is None
    (tmp_path / "status").write_text(STATUS)
    assert installation.package_version(package) == "0.2.6"
    assert installation.package_version("rmw_cyclonedds_cpp") is None
    monkeypatch.delenv("ROS_DISTRO")
    assert installation.package_version(package) is None

    share = tmp_path / "share" / package
    (share / "cmake").mkdir(parents=True)
    (share / "cmake" / f"{package}Config-version.cmake").write_text('set(PACKAGE_VERSION "0.2.7")\nif(x)\n')
    assert installation.package_version(package) == "0.2.7"
    (share / "package.xml").write_text("<package><name>x</name><version> 0.2.8 </version></package>")
    assert installation.package_version(package) == "0.2.8"
    monkeypatch.setattr(metadata, "version", lambda name: {"ros-rmw-zenoh-cpp": "0.2.9"}[name])
    assert installation.package_version(package) == "0.2.9"


@pytest.mark.parametrize(
    ("rmw", "more", "said"),
    [
        (
            "rmw_zenoh_cpp",
            {"transport": Transport.SHM},
            "-o transport=shm is Fast DDS's, and the middleware here is rmw_zenoh_cpp",
        ),
        (
            "rmw_cyclonedds_cpp",
            {"tuned": True},
            "--tuned: no settings for large messages of rmw_cyclonedds_cpp are known",
        ),
        ("rmw_of_somebody", {"transport": Transport.UDP, "tuned": True}, "-o transport=udp is Fast DDS's"),
        (
            "rmw_zenoh_cpp",
            {"qos": Qos(extra={"deadline_ns": 5})},
            "-o deadline: rmw_zenoh_cpp does not implement it; leave it out",
        ),
        ("rmw_zenoh_cpp", {"qos": Qos(extra={"lifespan_ns": 5})}, "-o lifespan: rmw_zenoh_cpp does not implement it"),
    ],
)
def test_settings_of_one_vendor_are_refused_on_the_others_before_anything_is_opened(rmw, more, said):
    backend = load_backend("ros2")
    with pytest.raises(OptionError, match=said):
        backend.check(NodeOptions(rmw=rmw, **more))
    backend.check(NodeOptions(rmw=rmw))
    backend.check(NodeOptions(rmw="rmw_fastrtps_cpp", discovery=Discovery.LOCALHOST, **more))
    backend.check(NodeOptions(**more))  # of the running middleware, which is asked once it runs


@pytest.mark.parametrize(
    ("version", "variable"),
    [
        (None, "FASTRTPS_DEFAULT_PROFILES_FILE"),
        ("3.2.3", "FASTDDS_DEFAULT_PROFILES_FILE"),  # which warns of the other one, and then loads the profile twice
    ],
)
def test_a_profile_of_ours_is_named_by_the_variable_that_the_installed_fast_dds_reads(monkeypatch, version, variable):
    monkeypatch.setattr(installation, "package_version", lambda package: {"fastdds": version}[package])
    running = installation.fast_dds.__wrapped__()
    monkeypatch.setattr(fastdds_profile, "fast_dds", lambda: running)
    environment = fastdds_profile.profile_environment(fastdds_profile.Path("/x.xml"), {})
    assert [name for name in environment if "PROFILES" in name] == [variable]


OLD, NEW = ((one.profile_variables[0], one.profile_file) for one in (installation.FAST_DDS_2, installation.FAST_DDS_3))


@pytest.mark.parametrize(
    ("running", "variables", "files", "path", "ignored"),
    [
        (2, {OLD[0]: "old", NEW[0]: "new"}, [], "old", ""),
        (2, {NEW[0]: "new"}, [OLD[1]], OLD[1], ""),
        (2, {NEW[0]: "new"}, [], "", NEW[0]),
        (2, {}, [NEW[1]], "", f"./{NEW[1]}"),
        (3, {OLD[0]: "old", NEW[0]: "new"}, [], "new", ""),
        (3, {OLD[0]: "old"}, [NEW[1]], "old", ""),  # rmw_fastrtps passes it on
        (3, {}, [OLD[1]], "", f"./{OLD[1]}"),
        (3, {}, [], "", ""),
    ],
)
def test_a_profile_counts_only_where_the_running_fast_dds_reads_it(
    monkeypatch, tmp_path, running, variables, files, path, ignored
):
    monkeypatch.chdir(tmp_path)
    for name in files:
        Path(name).touch()
    facts = installation.FAST_DDS_2 if running == 2 else installation.FAST_DDS_3
    monkeypatch.setattr(installation, "fast_dds", lambda: facts)
    monkeypatch.setattr(installation, "package_version", lambda _: f"{running}.1")
    read, words = installation.profile_of(None, variables)
    assert (read, words.partition(" is ignored: ")[0]) == (path, ignored)
    assert not words or words.endswith(
        f"Fast DDS {running}.1 reads {facts.profile_variables[0]} or ./{facts.profile_file}"
    )
    assert installation.profile_of("rmw_cyclonedds_cpp", variables) == ("", "")


@pytest.mark.parametrize(("facts", "segment"), [(installation.FAST_DDS_2, ""), (installation.FAST_DDS_3, "8704000")])
def test_large_data_has_the_segment_of_its_generation(monkeypatch, facts, segment):
    monkeypatch.setattr(fastdds_profile, "fast_dds", lambda: facts)
    monkeypatch.setattr(installation, "fast_dds", lambda: facts)
    text = fastdds_profile.localhost_profile(Transport.LARGE_DATA)
    assert "".join(re.findall("<segment_size>(.*)<", text)) == segment
    assert "segment_size" not in fastdds_profile.localhost_profile(Transport.SHM)
    options = NodeOptions(transport=Transport.LARGE_DATA)
    described = installation.describe_middleware(options, "rmw_fastrtps_cpp", "single", {})
    assert described.settings.get("segment_bytes", "") == segment

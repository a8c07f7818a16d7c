from importlib import metadata

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
    ("version", "variables"),
    [
        (None, ["FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"]),
        ("3.2.3", ["FASTDDS_DEFAULT_PROFILES_FILE"]),  # which warns of the other one, and then loads the profile twice
    ],
)
def test_a_profile_of_ours_is_named_by_the_variables_that_the_installed_fast_dds_reads(monkeypatch, version, variables):
    monkeypatch.setattr(fastdds_profile, "package_version", lambda package: {"fastdds": version}[package])
    told = fastdds_profile.profile_environment(fastdds_profile.Path("/x.xml"), {})
    assert [name for name in told if "PROFILES" in name] == variables

"""Which middlewares are here: a test skips by name where one is missing."""

from importlib.util import find_spec

import pytest

PACKAGES = {"ros2": "rclpy", "cyclonedds": "cyclonedds", "zenoh": "zenoh", "socket": "socket"}


def missing(*backends: str) -> str:
    return ", ".join(PACKAGES[name] for name in backends if find_spec(PACKAGES[name]) is None)


def needs(*backends: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(bool(missing(*backends)), reason=f"not installed: {missing(*backends)}")


def skip_without(*backends: str) -> None:
    if missing(*backends):
        pytest.skip(f"not installed: {missing(*backends)}")

"""ROS 2's packaging: what `colcon build` installs. pip reads ../pyproject.toml and never this file.

colcon finds a package of build type ament_python by its setup.py and takes it apart with setuptools; a pyproject.toml alone
it does not build (colcon-core issue 208). This file has a folder of its own because setuptools also reads a pyproject.toml
that lies beside it, and those of Ubuntu 22.04 and 24.04 are older than the form of the licence in ours (setuptools 77).
"""

from __future__ import annotations

import re
from pathlib import Path

from setuptools import setup

PACKAGE = "dds_trace"
ROOT = Path(__file__).resolve().parents[1]  # resolved: with --symlink-install colcon runs a link to this file
ROOMS = ("src/dds_trace/base", "analyzer", "cli", "extensions", "recorder", "reports", "tracefile")


def version() -> str:
    """Return the version of dds-trace."""
    found = re.search(
        r'^__version__ = "(.+)"$', (ROOT / "src" / PACKAGE / "base" / "version.py").read_text(), re.MULTILINE
    )
    assert found is not None
    return found[1]


def packages() -> list[str]:
    """Return the import names of all packages: a folder of a room is one if it has an `__init__.py`."""
    folders = (path.parent for room in ROOMS for path in (ROOT / room).rglob("__init__.py"))
    return [
        PACKAGE,
        *sorted(
            ".".join((PACKAGE, *folder.relative_to(ROOT).as_posix().removeprefix("src/dds_trace/").split("/")))
            for folder in folders
        ),
    ]


setup(
    name=PACKAGE,
    version=version(),
    description="MCAP trace recorder and offline analyzer for the latency of ROS 2 / DDS communication",
    license="Apache-2.0",
    maintainer="The dds-trace maintainers",
    maintainer_email="maintainers@dds-trace.example",
    packages=packages(),
    # Relative, and only the top: colcon links the first level into its build folder when it makes a symlink install.
    package_dir={PACKAGE: "../src/dds_trace"},
    package_data={
        PACKAGE: ["py.typed"],
        f"{PACKAGE}.extensions.campaigns.studio": ["assets/*"],
        f"{PACKAGE}.extensions.topics": ["*.html"],
        f"{PACKAGE}.reports": ["report.schema.json"],
        f"{PACKAGE}.extensions.gates": ["comparison.schema.json"],
        f"{PACKAGE}.reports.html": ["assets/*.*", "assets/*/*"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
        (f"share/{PACKAGE}/launch", ["launch/ping_relay.launch.py"]),
    ],
    entry_points={
        "console_scripts": [
            f"{name} = {PACKAGE}.cli.{module}:main"
            for name, module in (("analyze", "dds_analyze"), ("record", "dds_record"), ("trace", "trace"))
        ]
    },
    install_requires=[],  # an old setuptools would refuse to start a command for want of one; see requirements.txt
    zip_safe=False,
)

"""Apache Otava in an environment of its own, as it pins a numpy."""

import subprocess
import sys
from pathlib import Path

import pytest

OTAVA = "apache-otava==0.8.0"


def otava_alone(folder: Path) -> Path:
    """Install it below the folder and return its program; skip the test where no package index answers."""
    environment = folder / "venv"
    subprocess.run([sys.executable, "-m", "venv", environment], check=True)
    if subprocess.run([environment / "bin/pip", "install", "-q", OTAVA], check=False).returncode:
        pytest.skip("no package index")
    return environment / "bin/otava"

# Recipes for people and CI. `just` lists them; each sets up what it needs.

set shell := ["bash", "-euo", "pipefail", "-c"]

python := env("DDS_TRACE_PYTHON", "3.11")
venv := justfile_directory() / ".venv"
bin := venv / "bin"

# Everything below runs on this machine only.
export ROS_AUTOMATIC_DISCOVERY_RANGE := "LOCALHOST"

_default:
    @just --list

# Make .venv with all extras (quick when nothing changed)
setup:
    @test -x {{bin}}/python || uv venv --quiet --python {{python}} {{venv}}
    @uv pip install --quiet --python {{bin}}/python -e '.[ros2,analyze,test,check]'

# Lint, format, types, import directions
check: setup
    {{bin}}/ruff check .
    {{bin}}/ruff format --check .
    {{bin}}/mypy
    {{bin}}/lint-imports

# Mend what ruff can mend
fix: setup
    {{bin}}/ruff check --fix .
    {{bin}}/ruff format .

# All tests that end within minutes
test *args: setup
    {{bin}}/pytest -m 'not slow' -n 4 {{args}}

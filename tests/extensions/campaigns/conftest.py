import pytest
from sweep_desk import Desk, write_invented_traces


@pytest.fixture(scope="module")
def invented_traces(tmp_path_factory):
    folder = tmp_path_factory.mktemp("invented")
    write_invented_traces(folder)
    return folder


@pytest.fixture
def desk(tmp_path, invented_traces, monkeypatch):
    made = Desk(tmp_path, invented_traces)
    monkeypatch.setenv("STAND_IN_FOLDER", str(made.stand_in))
    return made

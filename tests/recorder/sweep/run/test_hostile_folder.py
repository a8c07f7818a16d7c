import json

import pytest
from sweep_desk import FIRST, SECOND, files_of

from dds_trace.base.errors import OutputError, TraceFormatError


@pytest.fixture
def target(desk):
    folder = desk.folder / "home"
    folder.mkdir()
    (folder / "thesis.tex").write_text("mine")
    return folder


@pytest.fixture
def sweep_folder(desk):
    folder = desk.folder / "runs/plan"
    folder.mkdir(parents=True)
    return folder


def test_linked_folder_for_parts_is_refused(desk, sweep_folder, target):
    (sweep_folder / ".parts").symlink_to(target)
    with pytest.raises(OutputError, match=r"\.parts is a link"):
        desk.sweep()
    assert [path.name for path in target.iterdir()] == ["thesis.tex"]


def test_foreign_files_among_the_parts_stay_and_are_told(desk, sweep_folder, target):
    parts = sweep_folder / ".parts"
    (parts / "a folder").mkdir(parents=True)
    (parts / "notes.txt").write_text("mine")
    (parts / "recording.mcap").write_text("mine")
    (parts / "1-1700000000000-1.mcap").write_text("left by a killed sweep")
    (parts / f"{FIRST}.ping.mcap").symlink_to(target / "thesis.tex")
    (parts / f"{FIRST}.ping.mcap.log").symlink_to(target / "thesis.tex")
    assert desk.sweep().missing == {}
    assert [name for name in desk.traces if name != "recording.mcap"] == files_of(FIRST, SECOND)
    assert sorted(path.name for path in parts.iterdir()) == ["a folder", "notes.txt", "recording.mcap"]
    assert (target / "thesis.tex").read_text() == "mine"


def test_folder_in_the_place_of_a_log_is_one_clear_error(desk, sweep_folder):
    (sweep_folder / f".parts/{FIRST}.ping.mcap.log").mkdir(parents=True)
    with pytest.raises(OutputError, match=r"\.log"):
        desk.sweep()


def test_folder_in_the_place_of_a_trace_is_one_clear_error(desk, sweep_folder):
    (sweep_folder / f"{FIRST}.ping.mcap").mkdir()
    with pytest.raises(OutputError, match=f"{FIRST}.ping.mcap"):
        desk.sweep()
    assert (sweep_folder / f"{FIRST}.ping.mcap").is_dir()


def test_linked_lock_is_refused(desk, sweep_folder, target):
    (sweep_folder / ".lock").symlink_to(target / "made.txt")
    with pytest.raises(OutputError):
        desk.sweep()
    assert [path.name for path in target.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("cell", "segment"), [("../../home/thesis", "1-17-1.mcap"), (FIRST, "../../../home/thesis"), (FIRST, "*")]
)
def test_state_that_names_files_outside_is_refused_and_removes_nothing(desk, sweep_folder, target, cell, segment):
    desk.sweep()
    state = json.loads((sweep_folder / "state.json").read_text())
    held = state["cells"].pop(FIRST)
    state["cells"][cell] = {**held, "status": "recorded", "segment": segment}
    (sweep_folder / "state.json").write_text(json.dumps(state))
    (target / "thesis.ping.mcap").write_text("mine")
    before = sorted(desk.folder.rglob("*"))
    with pytest.raises(TraceFormatError, match="not the state of a sweep"):
        desk.sweep()
    assert sorted(desk.folder.rglob("*")) == before

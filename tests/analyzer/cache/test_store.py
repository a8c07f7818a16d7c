"""The cache of read traces: what is in it is ours, whole, and of the trace that is asked for; nothing else is touched."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from cache_entries import describe_anew
from campaigns import assert_same_results, write_runs
from file_damage import DAMAGES
from trace_files import Message, ping_events, ping_session, relay_session, run, write_trace

import dds_trace.analyzer.cache.store
import dds_trace.analyzer.cache.traces
from dds_trace.analyzer.cache.store import TraceCache
from dds_trace.analyzer.pipeline import analyze
from dds_trace.tracefile.format.events import Stage


@pytest.fixture
def runs(tmp_path):
    write_runs(tmp_path / "runs", range(1))
    return tmp_path / "runs"


@pytest.fixture
def traces(own_base_folders):
    """Folder of the entries."""
    return own_base_folders / "cache/dds-trace/traces"


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_foreign_files_in_a_folder_called_cache_stay(runs, tmp_path):
    """`dds-analyze base --out proj` removed `proj/cache/important.sqlite` once."""
    important = tmp_path / "proj/cache/important.sqlite"
    important.parent.mkdir(parents=True)
    important.write_text("mine")
    for _ in range(2):
        analyze(runs, out=tmp_path / "proj", cache=True)
    assert important.read_text() == "mine"
    assert names_in(important.parent) == ["important.sqlite"]


def test_a_folder_of_somebody_with_a_link_in_the_place_of_the_old_cache(runs, tmp_path):
    home = tmp_path / "home"
    home.mkdir()
    (home / "thesis.tex").write_text("mine")
    (runs / "analysis").mkdir()
    (runs / "analysis/cache").symlink_to(home)
    analyze(runs, out=runs / "analysis", cache=True)
    assert names_in(home) == ["thesis.tex"]


def test_foreign_names_links_and_folders_among_the_entries_stay(runs, traces, tmp_path, monkeypatch):
    monkeypatch.setattr(dds_trace.analyzer.cache.store, "MOST_BYTES", 0)
    analyze(runs, cache=True)
    assert names_in(traces) == []
    key, target = "ab" * 32, tmp_path / "target"
    target.write_text("somebody else's")
    (traces / "notes.json").write_text("{}")
    (traces / f"{key}.trace.bak").write_text("{}")
    (traces / f"{key}.trace").symlink_to(target)
    (traces / f"{key}.details").mkdir()
    (traces / f"{'cd' * 32}.trace.12345678.part").write_text("left by a killed analysis")
    for ending in ("json", "events"):
        (traces / f"{'ef' * 32}.{ending}").write_text("left by an earlier version")
    analyze(runs, cache=True)
    assert names_in(traces) == sorted(["notes.json", f"{key}.trace.bak", f"{key}.trace", f"{key}.details"])
    assert target.read_text() == "somebody else's"


@pytest.mark.parametrize("linked", ["cache/dds-trace", "cache/dds-trace/traces", "state/dds-trace"])
def test_a_linked_folder_is_not_used(runs, own_base_folders, tmp_path, linked):
    target = tmp_path / "target"
    target.mkdir()
    (target / f"{'ab' * 32}.trace").write_text("mine")
    (own_base_folders / linked).parent.mkdir(parents=True)
    (own_base_folders / linked).symlink_to(target)
    assert TraceCache.open() is None
    analyze(runs, cache=True)
    assert names_in(target) == [f"{'ab' * 32}.trace"]


def test_a_folder_of_somebody_else_is_not_used(monkeypatch):
    TraceCache.open().close()
    us = os.geteuid()
    monkeypatch.setattr(os, "geteuid", lambda: us + 1)
    assert TraceCache.open() is None


def test_folder_and_key_are_for_this_user_alone(runs, own_base_folders, traces):
    (own_base_folders / "cache/dds-trace").mkdir(parents=True)
    (own_base_folders / "cache/dds-trace").chmod(0o777)
    analyze(runs, cache=True)
    for folder in (traces, traces.parent, own_base_folders / "state/dds-trace"):
        assert folder.stat().st_mode & 0o777 == 0o700
    assert (own_base_folders / "state/dds-trace/cache-key").stat().st_mode & 0o777 == 0o600


def test_the_least_recently_used_entries_leave_a_cache_that_is_full(tmp_path, traces, monkeypatch):
    for number in range(3):
        write_runs(tmp_path / f"runs{number}", [number])
        analyze(tmp_path / f"runs{number}", cache=True)
    sizes = {path.name: path.stat().st_size for path in traces.iterdir()}
    assert len(sizes) == 15
    for path in traces.iterdir():
        os.utime(path, (1, 1))
    monkeypatch.setattr(dds_trace.analyzer.cache.store, "MOST_BYTES", sum(sizes.values()) // 3 + 64)
    analyze(tmp_path / "runs1", cache=True)
    assert len(names_in(traces)) == 5
    for path in traces.iterdir():
        assert path.stat().st_mtime > 1


def test_the_documentation_says_how_large_the_cache_becomes():
    page = (Path(__file__).parents[3] / "docs/how-to/analyze.md").read_text()
    assert f"It holds at most {dds_trace.analyzer.cache.store.MOST_BYTES / (1 << 30):g} GiB" in page


def test_entries_stay_while_another_analysis_has_them_open(runs, traces, monkeypatch):
    other = TraceCache.open()
    monkeypatch.setattr(dds_trace.analyzer.cache.store, "MOST_BYTES", 0)
    analyze(runs, cache=True)
    assert len(names_in(traces)) == 5
    other.close()
    assert names_in(traces) == []


def test_the_key_follows_from_every_part_of_a_file(tmp_path, own_base_folders):
    """A small one is read at once, a larger one in blocks of 4 MiB."""
    assert own_base_folders
    cache = TraceCache.open()
    sizes = [1, (1 << 20) - 1, 1 << 20, (1 << 20) + 1, (4 << 20) + 3]
    keys = []
    for size in sizes:
        for changed in {None, 0, size // 2, size - 1}:
            content = bytearray(size)
            if changed is not None:
                content[changed] = 1
            path = tmp_path / f"{size}_{changed}.mcap"
            path.write_bytes(content)
            keys.append(cache.key_of(path))
    assert len(set(keys)) == len(keys)
    path.rename(tmp_path / "moved.mcap")
    assert cache.key_of(tmp_path / "moved.mcap") == keys[-1]
    cache.close()


def test_events_that_are_gone_in_the_middle_are_read_from_their_trace(runs, traces, files_read):
    first = dds_trace.analyzer.cache.traces.TraceLoader(TraceCache.open())
    first.load(runs / "ping0.mcap", 0)
    first.close()
    loader = dds_trace.analyzer.cache.traces.TraceLoader(TraceCache.open())
    known = loader.load(runs / "ping0.mcap", 0)
    files_read.clear()
    shutil.rmtree(traces)
    for part in known.parts.values():
        assert len(part.load()) == part.count
    assert set(files_read) == {"ping0.mcap"}
    loader.close()


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_entry_is_read_anew(runs, traces, assert_read_again, damage):
    first = analyze(runs, cache=True)
    for path in list(traces.glob("*.trace")):
        damage(path)
    assert_read_again(runs, first)


@pytest.mark.parametrize("place", ["events", "text", "seal", "first of size", "last of size"])
def test_a_changed_byte_is_noticed_wherever_it_is(runs, traces, assert_read_again, place):
    first = analyze(runs, cache=True)
    for path in traces.glob("*.rows"):
        path.unlink()  # else nobody needs the events
    cache = TraceCache.open()
    for path in traces.glob("*.trace"):
        text, events_bytes = cache.read_end(path.stem)
        places = {"events": 3, "text": events_bytes + 5, "seal": events_bytes + len(text) + 9}
        data = bytearray(path.read_bytes())
        data[places.get(place, -16 if place == "first of size" else -1)] ^= 1
        path.write_bytes(data)
    cache.close()
    assert_read_again(runs, first)


@pytest.mark.parametrize("end", [b"", b"f" * 15, b"-" + b"f" * 15, b"x" * 16, b"0" * 16, b"f" * 16])
def test_an_entry_with_any_end_is_read_anew(runs, traces, assert_read_again, end):
    first = analyze(runs, cache=True)
    for path in traces.glob("*.trace"):
        path.write_bytes(b"0" * 64 * bool(end) + end)
    assert_read_again(runs, first)


def test_a_description_larger_than_what_is_read_at_first_is_known(tmp_path, files_read, monkeypatch):
    monkeypatch.setattr(dds_trace.analyzer.cache.store, "_END_BYTES", 100)
    write_runs(tmp_path, range(1))
    first = analyze(tmp_path, cache=True)
    files_read.clear()
    assert_same_results(analyze(tmp_path, cache=True), first)
    assert files_read == []


def test_a_description_that_is_too_large_is_not_kept(tmp_path, traces, assert_read_again, monkeypatch):
    monkeypatch.setattr(dds_trace.analyzer.cache.store, "MOST_TEXT_BYTES", 100)
    write_runs(tmp_path, range(1))
    first = analyze(tmp_path, cache=True)
    assert list(traces.glob("*.trace*")) == []
    assert_read_again(tmp_path, first)


def test_an_entry_of_another_trace_is_not_believed(tmp_path, runs, traces, assert_read_again):
    first = analyze(runs, cache=True)
    keys = {path.stem for path in traces.glob("*.trace")}
    write_runs(tmp_path / "forged", range(1), latency_ns=9999)
    analyze(tmp_path / "forged", cache=True)
    forged = sorted({path.stem for path in traces.glob("*.trace")} - keys)
    for key in keys:
        shutil.copy(traces / f"{forged[0]}.trace", traces / f"{key}.trace")
    assert_read_again(runs, first)


def test_an_entry_that_another_user_sealed_is_not_believed(runs, own_base_folders, assert_read_again):
    """A CI server restores caches that a stranger's pull request wrote."""
    first = analyze(runs, cache=True)
    (own_base_folders / "state/dds-trace/cache-key").unlink()
    assert_read_again(runs, first)


@pytest.mark.parametrize("key", [b"", b"short", b"x" * 32, None])
def test_a_key_that_is_damaged_or_open_to_others_is_made_anew(runs, own_base_folders, key):
    path = own_base_folders / "state/dds-trace/cache-key"
    path.parent.mkdir(parents=True)
    if key is None:
        os.mkfifo(path)
    else:
        path.write_bytes(key)
        path.chmod(0o644)
    analyze(runs, cache=True)
    assert path.stat().st_size == 32
    assert path.stat().st_mode & 0o777 == 0o600
    assert path.read_bytes() != key


def forge(cache, traces, change):
    """Change the JSON of every entry and seal it again, as only this user can."""
    for path in traces.glob("*.trace"):
        entry = json.loads(cache.read_end(path.stem)[0])
        change(entry)
        describe_anew(cache, path.stem, entry)


def move_beyond_the_events(entry):
    """Say that the last column of the file is a byte further, in what is no longer events."""
    columns = entry["parts"][-1][5][-1][1]
    name = max((name for name, (how, _) in columns.items() if how == "array"), key=lambda n: columns[n][1])
    columns[name][1] += 1


@pytest.mark.parametrize(
    "change",
    [
        move_beyond_the_events,
        lambda entry: entry.update(format=99),
        lambda entry: entry.update(parts=3),
        lambda entry: entry["parts"][0][5][0].__setitem__(0, 10**15),
        lambda entry: entry["parts"][0][5][0].__setitem__(0, -1),
        lambda entry: entry["parts"][0][5][0].__setitem__(0, True),
        lambda entry: entry["parts"][0][5][0].__setitem__(0, "5"),
        lambda entry: entry["parts"][0][5][0][1].update(monotonic_ns=["array", 1 << 40]),
        lambda entry: entry["parts"][0][5][0][1].update(monotonic_ns=["array", -8]),
        lambda entry: entry["parts"][0][5][0][1].update(run_id=["constant", 1 << 70]),
        lambda entry: entry["parts"][0][5][0][1].update(run_id=["elsewhere", 1]),
        lambda entry: entry["parts"][0][5][0][1].update(sequence=["counting", 2**64 - 2]),
        lambda entry: entry["parts"][0][5][0][1].clear(),
        lambda entry: entry["parts"][0][5].clear(),
        lambda entry: entry["seals"].pop(),
        lambda entry: entry.clear(),
    ],
)
def test_lengths_and_values_are_checked_before_they_are_used(runs, traces, assert_read_again, change):
    first = analyze(runs, cache=True)
    cache = TraceCache.open()
    forge(cache, traces, change)
    cache.close()
    assert_read_again(runs, first)


@pytest.fixture
def sealed(own_base_folders):
    """An open cache, the key of a sealed entry in it, and its path."""
    assert own_base_folders
    cache, key = TraceCache.open(), "ab" * 32
    with cache.writing(key, "rows") as stream:
        for part in (b"rows" * (3 << 18), memoryview(b"end")):
            stream.write(part)
        assert stream.tell() == 4 * (3 << 18) + 3
    yield cache, key, cache.path(key, "rows")
    cache.close()


def test_a_sealed_entry_is_read_as_it_was_written(sealed):
    cache, key, path = sealed
    os.utime(path, (1, 1))
    assert cache.read(key, "rows") == b"rows" * (3 << 18) + b"end"
    assert path.stat().st_mtime > 1


@pytest.mark.parametrize("damage", [*DAMAGES, os.unlink])
def test_a_sealed_entry_that_is_damaged_or_gone_is_not_read(sealed, damage):
    cache, key, path = sealed
    damage(path)
    with pytest.raises((OSError, ValueError)):
        cache.read(key, "rows")


def test_a_sealed_entry_of_another_key_is_not_read(sealed):
    cache, _key, path = sealed
    shutil.copy(path, cache.path("cd" * 32, "rows"))
    with pytest.raises(ValueError, match="sealed"):
        cache.read("cd" * 32, "rows")


def test_an_entry_whose_writer_fails_is_not_there(sealed):
    cache, key, path = sealed
    before = path.read_bytes()
    with pytest.raises(TypeError), cache.writing(key, "rows") as stream:
        stream.write("text")
    assert path.read_bytes() == before


def test_a_trace_of_one_stage_alone_and_one_without_events_are_known(tmp_path, files_read):
    events = ping_events([Message(n, t1=n) for n in range(3)])
    write_trace(tmp_path / "t1.mcap", ping_session(), [run()], {Stage.T1: events[Stage.T1]})
    write_trace(tmp_path / "relay.mcap", relay_session())
    for _ in range(2):
        assert analyze(tmp_path, cache=True).summary["published"].to_list() == [3]
    assert files_read == ["relay.mcap", "t1.mcap"]


def test_a_disk_that_is_full_costs_the_cache_and_not_the_analysis(runs, monkeypatch):
    def full(*_, **__):
        raise OSError(28, "No space left on device")

    whole = analyze(runs)
    for method in ("writing", "write_end"):
        monkeypatch.setattr(TraceCache, method, full)
    assert_same_results(analyze(runs, cache=True), whole)


def test_a_user_without_a_home_has_no_cache(runs, monkeypatch):
    whole = analyze(runs)
    monkeypatch.setenv("XDG_CACHE_HOME", "not/absolute")
    monkeypatch.setenv("HOME", "/dev/null/nowhere")
    assert TraceCache.open() is None
    assert_same_results(analyze(runs, cache=True), whole)

"""A database with a log is read as SQLite would leave it, and SQLite is handed neither."""

import json
import random
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
from bags import ROS1, imu, text, write_bag1, write_bag2
from file_guard import touched
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from dds_trace.extensions.bags import sqlite_log
from dds_trace.extensions.bags.recorded import Condition
from dds_trace.extensions.bags.sqlite_rows import SQLITE_TABLES, sqlite_messages

KEYS = "SELECT id, timestamp, data FROM messages ORDER BY id"


def insert(database, draw, count):
    sizes = (0, 5, 300, 5_000, 70_000)
    rows = [(draw.randrange(1, 3), draw.randrange(10**18), draw.randbytes(draw.choice(sizes))) for _ in range(count)]
    database.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows)


def unfinished(folder: Path, kind: str, seed: int) -> Path:
    """Copy a database in the middle of a transaction, with its log, as a killed recorder leaves both."""
    draw, folder = random.Random(seed), folder / str(seed)
    folder.mkdir()
    path = folder / "made.db3"
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute(f"PRAGMA page_size={draw.choice((512, 1024, 4096, 65536))}")
        database.execute(
            f"PRAGMA synchronous={draw.choice(('OFF', 'NORMAL'))}"
        )  # OFF: a journal that goes on to its end
        database.executescript(SQLITE_TABLES)
        for number in (1, 2):
            database.execute(f"INSERT INTO topics VALUES ({number}, '/t{number}', 'a/msg/B', 'cdr', 'qos', 'RIHS')")
        database.execute("INSERT INTO message_definitions VALUES (1, 'a/msg/B', 'ros2msg', 'int8 x', '')")
        insert(database, draw, 40)
        database.execute(f"PRAGMA journal_mode={kind}")
        database.execute("PRAGMA cache_size=4")  # pages of an unfinished transaction reach the files
        database.execute("PRAGMA cache_spill=4")
        if kind == "WAL":
            database.execute("PRAGMA wal_autocheckpoint=0")
            insert(database, draw, 30)
            if draw.random() < 0.7:  # frames of the time before a checkpoint stay in the file
                database.execute("PRAGMA wal_checkpoint(RESTART)")
            insert(database, draw, draw.randrange(12))
            database.execute("DELETE FROM messages WHERE id % 3 = 0")
            if draw.random() < 0.5:
                database.execute("PRAGMA incremental_vacuum")
        database.execute("BEGIN")
        database.execute("UPDATE messages SET timestamp = timestamp + 1, data = data || x'07'")
        insert(database, draw, 20)
        copy = folder / "bag.db3"
        for suffix in ("", "-wal", "-journal"):
            if path.with_name(path.name + suffix).exists():
                shutil.copy(path.with_name(path.name + suffix), copy.with_name(copy.name + suffix))
        database.execute("ROLLBACK")
    return copy


def rows_by_sqlite(path: Path, folder: Path) -> list[tuple[int, int, bytes]]:
    copies = [shutil.copy(file, folder / f"oracle{file.name[3:]}") for file in path.parent.glob(f"{path.name}*")]
    with closing(sqlite3.connect(min(copies))) as database:
        return database.execute(KEYS).fetchall()


@pytest.mark.keeps(3)
@pytest.mark.parametrize("kind", ["WAL", "DELETE", "PERSIST"])
@pytest.mark.parametrize("seed", range(4))
def test_what_sqlite_reads_is_read(tmp_path, kind, seed):
    path, condition = unfinished(tmp_path, kind, seed), Condition()
    log = path.with_name(f"bag.db3-{'wal' if kind == 'WAL' else 'journal'}")
    assert log.stat().st_size > 1000
    found = [(time_ns, data) for _, time_ns, *_, data in sqlite_messages(path, condition)]
    expected = rows_by_sqlite(path, tmp_path)
    assert found[: len(expected)] == [row[1:] for row in expected]
    assert len(expected) > 20
    assert any(log.name in note for note in condition.notes)
    assert {topic.type_hash for topic in condition.topics} == {"RIHS"}
    assert {topic.definition for topic in condition.topics} == {"int8 x"}


@pytest.mark.parametrize("change", ["DELETE FROM messages WHERE id % 3 = 0", "VACUUM", "DELETE FROM messages"])
def test_a_database_that_is_written_meanwhile_is_not_called_damaged(tmp_path, change):
    path, draw, condition = tmp_path / "bag.db3", random.Random(0), Condition()
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.executescript(SQLITE_TABLES)
        for number in (1, 2):
            database.execute(f"INSERT INTO topics VALUES ({number}, '/t{number}', 'a/msg/B', 'cdr', 'qos', 'RIHS')")
        insert(database, draw, 400)
        messages = sqlite_messages(path, condition)
        next(messages)
        database.execute(change)
        insert(database, draw, 100)
        list(messages)
    (damage,) = condition.damages
    assert damage.startswith("it was written while")


@pytest.mark.parametrize("kind", ["WAL", "DELETE"])
def test_sqlite_is_handed_no_database_that_has_a_log(tmp_path, kind, monkeypatch):
    path, handed = unfinished(tmp_path, kind, 1), []
    monkeypatch.setattr(sqlite3, "connect", lambda *args, **_: handed.append(args))
    assert len(list(sqlite_messages(path, Condition()))) > 20
    assert not handed


@pytest.mark.keeps(1)
@pytest.mark.parametrize("kind", ["WAL", "DELETE"])
def test_what_follows_the_pages_of_a_log_is_not_looked_at(tmp_path, kind):
    path, plain = unfinished(tmp_path, kind, 3), unfinished(tmp_path, kind, 4).parent
    log = path.with_name(f"bag.db3-{'wal' if kind == 'WAL' else 'journal'}")
    whole = list(sqlite_messages(path, Condition()))
    with log.open("ab") as stream:
        stream.write(str(plain).encode() + bytes(100))
    assert list(sqlite_messages(path, Condition())) == whole


def test_a_log_far_larger_than_its_database_is_left_out(tmp_path):
    path, condition = unfinished(tmp_path, "WAL", 5), Condition()
    with closing(sqlite3.connect(f"file:{path}?immutable=1", uri=True)) as database:
        expected = database.execute(KEYS).fetchall()
    with path.with_name("bag.db3-wal").open("r+b") as log:
        log.truncate(sqlite_log._MOST_LOG_BYTES + (1 << 20))
    found = list(sqlite_messages(path, condition))
    assert [message.log_ns for message in found][: len(expected)] == [row[1] for row in expected]
    assert any("bag.db3-wal is left out" in damage and "1024 MiB" in damage for damage in condition.damages)


PROGRAM = """
import json, sys
from contextlib import suppress
from dds_trace.cli.trace import main
from dds_trace.extensions.bags.payload import load_payload
for sys.argv in json.loads(sys.argv[1]):
    print(sys.argv, file=_report, flush=True)
    if sys.argv[1] == "payload":
        load_payload(f"{sys.argv[2]}#/imu", {})
    else:
        with suppress(SystemExit):
            main()
"""
MESSAGES = {"/imu": [imu(0.1), imu(0.2)], "/chatter": [text("hello")]}


def changed_database(folder, journal_mode, *, is_left):
    """A bag of SQLite in a journal mode, with a transaction that is not finished, or closed without a log."""
    bag = write_bag2(folder / "bag", MESSAGES, StoragePlugin.SQLITE3)
    with closing(sqlite3.connect(bag / "bag.db3", isolation_level=None)) as database:
        database.execute(f"PRAGMA journal_mode={journal_mode}")
        database.execute("PRAGMA cache_size=1")
        database.execute("UPDATE messages SET timestamp = timestamp + 1")
        if is_left:
            database.execute("BEGIN")
            insert(database, random.Random(0), 20)
            shutil.copytree(bag, folder / "left")
            (folder / "left" / "bag.db3-shm").unlink(missing_ok=True)
            database.execute("ROLLBACK")
    if is_left:
        shutil.rmtree(bag)
        (folder / "left").rename(bag)
    return bag


RECORDINGS = {
    "sqlite": lambda folder: write_bag2(folder / "bag", MESSAGES, StoragePlugin.SQLITE3),
    "sqlite in the mode of logs": lambda folder: changed_database(folder, "WAL", is_left=False),
    "sqlite log": lambda folder: changed_database(folder, "WAL", is_left=True),
    "sqlite journal": lambda folder: changed_database(folder, "DELETE", is_left=True),
    "mcap": lambda folder: write_bag2(folder / "bag", MESSAGES, StoragePlugin.MCAP),
    "packed": lambda folder: write_bag2(folder / "bag", MESSAGES, StoragePlugin.MCAP, mode=CompressionMode.FILE),
    "ros1": lambda folder: write_bag1(folder / "bag.bag", {"/imu": [imu(0.1, ROS1)], "/chatter": [text("x", ROS1)]}),
}


@pytest.mark.keeps(3)
@pytest.mark.parametrize("kind", RECORDINGS)
def test_nothing_of_a_strangers_recording_is_changed_nor_anything_next_to_it(tmp_path, kind, monkeypatch):
    """No path outside of the temporary folder and the outputs is opened for writing, renamed or removed, by us or a library."""
    (stranger, out, temporary, state) = (tmp_path / name for name in ("stranger", "out", "temporary", "state"))
    for folder in (stranger, out, temporary, state):
        folder.mkdir()
    for variable, folder in {"TMPDIR": temporary, "XDG_CACHE_HOME": state, "HOME": state}.items():
        monkeypatch.setenv(variable, str(folder))
    monkeypatch.chdir(stranger)
    (stranger / "mine.txt").write_text("a file of the user")
    recording = RECORDINGS[kind](stranger)
    runs = [
        ["dds-trace", "bag", str(recording)],
        ["dds-trace", "recover", str(recording), "--out", str(out / "recovered")],
        ["dds-trace", "analyze", str(recording), "--out", str(out / "analysis")],
        ["dds-trace", "payload", str(recording)],
    ]
    assert touched(PROGRAM, [json.dumps(runs)], stranger, [out, temporary, state]) == list(map(str, runs))
    assert not list(temporary.iterdir())
    assert any(out.iterdir())
    assert (stranger / "mine.txt").read_text() == "a file of the user"


@pytest.mark.parametrize(
    "deed",
    [
        "open(sys.argv[1] + '/new', 'w')",
        "os.remove(sys.argv[1] + '/mine.txt')",
        "os.rename(sys.argv[1] + '/mine.txt', sys.argv[1] + '/b')",
        "import sqlite3; sqlite3.connect(sys.argv[1] + '/a.db').execute('CREATE TABLE a (b)')",
        "import polars; polars.DataFrame({'a': [1]}).write_parquet(sys.argv[1] + '/a.parquet')",
        "import subprocess; subprocess.run(['touch', sys.argv[1] + '/a'])",
    ],
)
def test_the_guard_sees_what_is_done(tmp_path, deed):
    (tmp_path / "mine.txt").touch()
    assert touched(deed, [tmp_path], tmp_path, [Path("/nowhere")])

"""Fixtures that every room's tests share."""

import fcntl
import json
import os
import shutil
import tempfile
import uuid
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import kept
import pytest
from hypothesis import settings
from page_fixtures import chromium, new_tab, pages, read_with, reader, show, tab
from shared_memory import middleware_files, remove_orphans
from thorough import mark_thorough

__all__ = ["chromium", "new_tab", "pages", "read_with", "reader", "show", "tab"]

# The tools themselves default to the subnet; tests never leave this machine.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

# No test asserts on absolute time, and hypothesis's deadline is one.
settings.register_profile("dds-trace", deadline=None)
settings.load_profile("dds-trace")

FIRST_DOMAIN, LAST_DOMAIN = 20, 99  # 5 and 10 are the demo's; above 101 ports meet the ephemeral range


class DomainLease:
    """Domain ids that no other test on this machine uses at the moment, held by locked files."""

    def __init__(self) -> None:
        self._folder = Path(tempfile.gettempdir()) / "dds-trace-test-domains"
        self._folder.mkdir(exist_ok=True)
        self._held: list[int] = []

    def take(self) -> int:
        for domain_id in range(FIRST_DOMAIN, LAST_DOMAIN + 1):
            with suppress(BlockingIOError):
                return self.wait_for(domain_id, fcntl.LOCK_NB)
        raise RuntimeError("all test domains are in use on this machine")

    def wait_for(self, domain_id: int, flags: int = 0) -> int:
        """This domain id until `release`, as soon as no other test has it."""
        descriptor = os.open(self._folder / str(domain_id), os.O_CREAT | os.O_RDWR)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | flags)
        except BlockingIOError:
            os.close(descriptor)
            raise
        self._held.append(descriptor)
        return domain_id

    def release(self) -> None:
        for descriptor in self._held:
            os.close(descriptor)


@pytest.fixture(autouse=True)
def own_base_folders(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the caches, keys and running recordings of the test: no test reads what another left, or touches the user's own."""
    folder = tmp_path_factory.getbasetemp() / f"xdg-{uuid.uuid4().hex}"
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    monkeypatch.setenv("DDS_TRACE_CONFIG", "")
    monkeypatch.setenv("XDG_STATE_HOME", str(folder / "state"))
    (folder / "run").mkdir(parents=True)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder / "run"))
    return folder


@pytest.fixture
def domains() -> Iterator[DomainLease]:
    lease = DomainLease()
    yield lease
    lease.release()


@pytest.fixture
def domain_id(domains: DomainLease) -> int:
    return domains.take()


_SHM_BEFORE = pytest.StashKey["set[Path]"]()


class ToldAtOnce:
    """Failures are printed when they happen: a worker that dies later takes pytest's own account of them with it."""

    def __init__(self, terminal: "pytest.TerminalReporter") -> None:
        self._terminal = terminal

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._terminal.write_line(f"\n{report.when} of {report.nodeid} failed:\n{report.longreprtext}")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Note the shared-memory files of others; tell of failures where there is a terminal, which no worker has.

    Before the workers start, which have the environment of this process.
    """
    session.config.stash[_SHM_BEFORE] = middleware_files()
    if not hasattr(session.config, "workerinput"):
        os.environ[kept.VARIABLE] = tempfile.mkdtemp(prefix="dds-trace-kept-")
    if terminal := session.config.pluginmanager.get_plugin("terminalreporter"):
        session.config.pluginmanager.register(ToldAtOnce(terminal))


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    mark_thorough(items)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Remove what was kept and what killed processes left, once all workers are done."""
    if not hasattr(session.config, "workerinput"):
        shutil.rmtree(os.environ.pop(kept.VARIABLE), ignore_errors=True)
        remove_orphans(session.config.stash[_SHM_BEFORE])


SENTENCES = Path(__file__).parent / "data" / "sentences.json"
"""Sentences that users read, by test: `DDS_TRACE_UPDATE_SENTENCES=1 pytest FILE -n0` writes them again, to be read in the diff."""


@pytest.fixture
def sentences(request: pytest.FixtureRequest) -> Callable[..., None]:
    """Compare sentences with those of the golden file, so that a test asserts codes and numbers and a sentence is changed in one place."""
    test = f"{request.path.relative_to(Path(__file__).parent)}::{request.node.name}"

    def check(*texts: str) -> None:
        golden = json.loads(SENTENCES.read_text(encoding="utf-8"))
        if os.environ.get("DDS_TRACE_UPDATE_SENTENCES"):
            golden[test] = list(texts)
            lines = json.dumps(golden, indent=1, sort_keys=True, ensure_ascii=False)
            SENTENCES.write_text(lines + "\n", encoding="utf-8")
        assert list(texts) == golden.get(test)

    return check

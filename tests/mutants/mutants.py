"""Change one operator or number of the core at a time and see whether a test notices: `just mutants`.

The tests of a part are collected once. For each mutant this process forks, the child gives the loaded module the changed
code, runs the tests that pass through the changed line, those first that are cheap and have noticed changes of this module,
and ends at the first that fails. Nothing is written to the tree. What was computed by an import may have gone elsewhere by
then, so a mutant of a line outside of functions that nobody noticed is tried once more with everything imported anew.
"""

import argparse
import ast
import importlib
import importlib.machinery
import json
import os
import pickle
import random
import resource
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import grafting
import pytest
from core import CORE, Part
from hypothesis import Phase, settings
from mutations import Mutant, mutants_of

ROOT = Path(__file__).parents[2]
EQUIVALENT = Path(__file__).with_name("equivalent.json")
LEAST_KILLED = 0.95
MOST_TEST_SECONDS = 60.0  # on a busy machine a part's own tests take so long
"""Tests that run through a mutant's line are taken, cheapest first, until they take this together, at least one."""
SPARE_SECONDS = 5.0
TIMES_LONGER = 3.0
"""A child whose tests take so many times as long as without the mutant, and this time to spare, has a loop without an end."""
MOST_CALLS = 200
WALL_FACTOR = 20.0
WALL_SPARE_SECONDS = 20.0
"""A test that waits so many times its processor time, and this time to spare, waits without an end; others may use this machine."""
LONGEST_SECONDS = 100_000.0
SURVIVED, KILLED = 0, 1

settings.register_profile(
    "mutants", deadline=None, database=None, derandomize=True, phases=[Phase.explicit, Phase.generate]
)


@dataclass(frozen=True)
class Module:
    """A module of the core: its file from the root, its lines, and its mutants by number."""

    path: str
    lines: list[str]
    tree: ast.Module
    mutants: list[Mutant]

    @property
    def name(self) -> str:
        return "dds_trace." + self.path.removesuffix(".py").replace("/", ".")

    @property
    def file(self) -> str:
        return str(ROOT / "src/dds_trace" / self.path)

    def place(self, number: int) -> tuple[str, str]:
        """The line of a mutant and its change, by which it is known when lines above it come or go."""
        mutant = self.mutants[number]
        return self.lines[mutant.line - 1].strip(), mutant.change

    def mutated(self, number: int) -> object:
        mutant = self.mutants[number]
        mutant.put(edited=True)
        try:
            return compile(self.tree, self.file, "exec", dont_inherit=True)
        finally:
            mutant.put(edited=False)


def modules_of(part: Part) -> list[Module]:
    found = []
    for name in part.modules:
        files = sorted((ROOT / name).glob("*.py")) if (ROOT / name).is_dir() else [ROOT / name]
        for path in files:
            text = path.read_text()
            tree = ast.parse(text)
            found.append(Module(str(path.relative_to(ROOT)), text.splitlines(), tree, mutants_of(tree)))
    return found


# What a child does.


class LinesRun:
    """The lines of some files that code runs through, as `sys.settrace` tells them; `take` hands them over.

    A function that is called again and again is followed the first `MOST_CALLS` times only: what it does later on and never did
    before is not seen, so that this test may be left out where a mutant of such a line is tried.
    """

    def __init__(self, files: Sequence[str]) -> None:
        self._files = frozenset(files)
        self._seen: set[tuple[str, int]] = set()
        self._calls: Counter[int] = Counter()

    def take(self) -> set[tuple[str, int]]:
        seen, self._seen = self._seen, set()
        self._calls.clear()
        return seen

    def start(self) -> None:
        threading.settrace(self._enter)
        sys.settrace(self._enter)

    def _enter(self, frame, _event, _argument):
        file, code = frame.f_code.co_filename, id(frame.f_code)
        if file not in self._files or self._calls[code] == MOST_CALLS:
            return None
        self._calls[code] += 1
        seen = self._seen

        def line(frame, event, _argument):
            if event == "line":
                seen.add((file, frame.f_lineno))
            return line

        return line


def passes(items: Sequence[pytest.Item], seconds: Sequence[float] = ()) -> Iterator[tuple[int, bool]]:
    """Run tests; where their processor time is given, a test that waits for what never comes ends this process."""
    from _pytest.runner import runtestprotocol

    for number, item in enumerate(items):
        if seconds:
            signal.setitimer(signal.ITIMER_REAL, WALL_SPARE_SECONDS + WALL_FACTOR * seconds[number])
        after = items[number + 1] if number + 1 < len(items) else None
        yield number, not any(each.failed for each in runtestprotocol(item, log=False, nextitem=after))


def measure(items: Sequence[pytest.Item], numbers: Sequence[int], files: Sequence[str], result: Path) -> int:
    """Run tests once; keep the processor time of each, None if it fails, and the lines that it runs through."""
    ours = [
        held for name, module in sys.modules.items() if name.startswith("dds_trace.") for held in vars(module).values()
    ]
    caches = [held for held in ours if hasattr(held, "cache_clear")]
    lines, found, begin = LinesRun(files), {}, time.process_time()
    lines.start()
    for place, passed in passes([items[number] for number in numbers]):
        took = time.process_time() - begin
        found[numbers[place]] = (took if passed else None), lines.take()
        for cached in caches:  # what one test was given from a cache, it runs through where it is alone
            cached.cache_clear()
        begin = time.process_time()
    sys.settrace(None)
    result.write_bytes(pickle.dumps(found))
    return 0


def forked(work: Callable[[], int], seconds: float) -> int:
    """Do `work` in a child that ends with what it returns, or by a signal after so much time; return its process id."""
    pid = os.fork()
    if pid:
        return pid
    code = KILLED
    try:
        os.setpgrp()
        resource.setrlimit(resource.RLIMIT_CPU, (int(seconds) + 1, int(seconds) + 1))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        signal.setitimer(signal.ITIMER_REAL, seconds * WALL_FACTOR)
        code = work()
    except BaseException:
        traceback.print_exc()
        raise
    finally:
        os._exit(code)


def ended(pids: Sequence[int]) -> tuple[int, int]:
    """Wait for one of these children; return its process id and 0 if it returned 0."""
    while True:
        for pid in pids:
            done, status = os.waitpid(pid, os.WNOHANG if len(pids) > 1 else 0)
            if done:
                with suppress(ProcessLookupError):
                    os.killpg(pid, signal.SIGKILL)
                return pid, int(status != 0)
        time.sleep(0.01)


def threads() -> list[str]:
    """The names of this process's threads, a library's own too."""
    return [(task / "comm").read_text().strip() for task in Path("/proc/self/task").iterdir()]


class Trials:
    """The pytest plugin of a part's process: it collects as ever, and tries mutants where the tests would run."""

    def __init__(self, modules: dict[str, Module], chosen: Sequence[tuple[str, int]], folder: Path, jobs: int) -> None:
        self._modules, self._chosen, self._folder, self._jobs = modules, chosen, folder, jobs
        self.survivors: list[tuple[str, int]] = []
        self._kills: Counter[tuple[str, int]] = Counter()  # by module and number of the test
        self.failing: list[str] = []
        self.cheapest: dict[str, str] = {}  # file of each test that tries a mutant of a line that runs at import
        self.computing: list[str] = []
        """Where the first query of polars ran while tests were collected: a forked child waits for its threads without end."""

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if not self.computing and any(name.startswith("polars-") and name[7:].isdigit() for name in threads()):
            self.computing.append(report.nodeid)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        if self.computing:
            return True
        items = session.items
        files = [each.file for each in self._modules.values()]
        results = [self._folder / f"measured-{job}" for job in range(self._jobs)]
        pids = {
            forked(partial(measure, items, range(job, len(items), self._jobs), files, result), LONGEST_SECONDS)
            for job, result in enumerate(results)
        }
        while pids:
            pids.remove(ended(list(pids))[0])
        measured = {number: each for result in results for number, each in pickle.loads(result.read_bytes()).items()}
        self.failing = [items[number].nodeid for number, (took, _) in measured.items() if took is None]
        seconds = {number: took for number, (took, _) in measured.items() if took is not None}
        runs = sorted((took, number, measured[number][1]) for number, took in seconds.items())
        running: dict[int, tuple[str, int]] = {}
        for path, number in self._chosen:
            module = self._modules[path]
            tests = self._tests_of(module, module.mutants[number], runs)
            if module.mutants[number].runs_at_import:
                self.cheapest = {items[each].nodeid: str(items[each].path) for each in tests}
            if not tests:
                self.survivors.append((path, number))
                continue
            if len(running) == self._jobs:
                self._await_one(running)
            tests.sort(key=lambda each: seconds[each] / (1 + self._kills[path, each]))
            took_each = [seconds[each] for each in tests]
            longest = SPARE_SECONDS + TIMES_LONGER * sum(took_each)
            running[forked(partial(self._try, module, number, items, tests, took_each), longest)] = path, number
        while running:
            self._await_one(running)
        return True

    @staticmethod
    def _tests_of(module: Module, mutant: Mutant, runs: list[tuple[float, int, set]]) -> list[int]:
        lines = {(module.file, line) for line in mutant.lines}
        tests, total = [], 0.0
        for seconds, number, seen in runs:
            if mutant.runs_at_import or lines & seen:
                total += seconds
                if tests and total > MOST_TEST_SECONDS:
                    break
                tests.append(number)
        return tests

    def _try(self, module: Module, number: int, items: list[pytest.Item], tests: list[int], took: list[float]) -> int:
        # A test may be the first to import it.
        grafting.graft(importlib.import_module(module.name), module.mutated(number))
        for place, passed in passes([items[each] for each in tests], took):
            if not passed:
                (self._folder / f"killer-{os.getpid()}").write_text(str(tests[place]))
                return KILLED
        return SURVIVED

    def _await_one(self, running: dict[int, tuple[str, int]]) -> None:
        pid, status = ended(list(running))
        mutant = running.pop(pid)
        if status == SURVIVED:
            self.survivors.append(mutant)
        with suppress(FileNotFoundError):  # none where a mutant runs on without an end
            self._kills[mutant[0], int((self._folder / f"killer-{pid}").read_text())] += 1


def pytest_words(tests: Sequence[str], folder: Path) -> list[str]:
    return [
        *("-q", "-x", "-p", "no:cacheprovider", "-p", "no:xdist", "--timeout=0", f"--rootdir={ROOT}"),
        *("-m", "not slow and not thorough and not middleware and not browser", "--hypothesis-profile=mutants"),
        *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # hypothesis is here already
        *(f"--basetemp={folder / 'pytest'}", *tests),
    ]


def try_part(part: Part, modules: dict[str, Module], chosen: Sequence[tuple[str, int]], folder: Path, jobs: int) -> int:
    """Try mutants of a part with its tests collected once; leave who survived in `folder`."""
    quiet()
    trials = Trials(modules, chosen, folder, jobs)
    pytest.main(pytest_words(part.tests, folder), plugins=[trials])
    (folder / "result").write_text(json.dumps([trials.survivors, trials.failing, trials.cheapest, trials.computing]))
    return 0


def try_anew(tests: Mapping[str, str], module: Module, number: int, folder: Path) -> int:
    quiet()
    code = module.mutated(number)

    class Loader(importlib.machinery.SourceFileLoader):
        def get_code(self, fullname: str):
            return code if fullname == module.name else super().get_code(fullname)

    class Finder:
        @staticmethod
        def find_spec(name: str, path: object, target: object = None):
            if name != module.name:
                return None
            spec = importlib.machinery.PathFinder.find_spec(name, path, target)
            spec.loader = Loader(spec.loader.name, spec.loader.path)
            return spec

        @staticmethod
        def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
            items[:] = (each for each in items if each.nodeid in tests)

    sys.meta_path.insert(0, Finder)
    code = pytest.main(pytest_words(sorted(set(tests.values())), folder), plugins=[Finder])
    return int(code not in (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED))


def quiet() -> None:
    nowhere = os.open(os.devnull, os.O_RDWR)
    for number in (0, 1, 2):
        os.dup2(nowhere, number)


# The whole.


def load_equivalent() -> dict[str, set[tuple[str, str]]]:
    """(line, change) by module of mutants that were looked at: they change nothing that a caller can see."""
    held = json.loads(EQUIVALENT.read_text())
    return {path: {(each["line"], each["change"]) for each in kept} for path, kept in held.items()}


def tried(name: str, share: float, seed: int, jobs: int) -> tuple[dict[str, Counter], list[str]]:
    """Try mutants of a part; return tried and killed ones by module, and a line for each survivor."""
    part, modules = CORE[name], {each.path: each for each in modules_of(CORE[name])}
    equivalent = load_equivalent()
    every = [
        (path, number)
        for path, module in modules.items()
        for number in range(len(module.mutants))
        if module.place(number) not in equivalent.get(path, ())
    ]
    draw = random.Random(f"{seed} {name}")
    chosen = sorted(draw.sample(every, max(1, round(share * len(every)))))
    folder = Path(tempfile.mkdtemp(prefix="dds-trace-mutants-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        ended([forked(lambda: try_part(part, modules, chosen, folder, jobs), LONGEST_SECONDS)])
        found, failing, cheapest, computing = json.loads((folder / "result").read_text())
        if computing:
            sys.exit(f"{computing[0]} runs a query of polars while it is collected; make its frames in the test")
        if failing:
            print("left out, as they fail here without any mutant:", *failing)
        survivors = {
            (path, number)
            for path, number in found
            if not modules[path].mutants[number].runs_at_import
            or _survives_anew(cheapest, modules[path], number, folder)
        }
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    counts = {path: Counter(tried=0, killed=0) for path in modules}
    lines = []
    for path, number in chosen:
        survived = (path, number) in survivors
        counts[path].update(tried=1, killed=int(not survived))
        if survived:
            mutant = modules[path].mutants[number]
            lines.append(f"survived: {path}:{mutant.line}: {mutant.change}")
    return counts, lines


def _survives_anew(tests: Mapping[str, str], module: Module, number: int, folder: Path) -> bool:
    return ended([forked(lambda: try_anew(tests, module, number, folder), 120)])[1] == SURVIVED


def main() -> None:
    """Try the mutants of the parts that are asked for; exit with 1 where too many survive."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*CORE, []], help="parts of the core, all by default")
    parser.add_argument("--share", type=float, default=1.0, help="share of the mutants that is drawn")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    asked = parser.parse_args()
    os.chdir(ROOT)
    total = Counter()
    for name in asked.parts or CORE:
        counts, lines = tried(name, asked.share, asked.seed, asked.jobs)
        for path, count in counts.items():
            if count["tried"]:
                print(f"{count['killed']:5}/{count['tried']:<5} {count['killed'] / count['tried']:4.0%}  {path}")
            total.update(count)
        print(*lines, sep="\n", flush=True)
    share = total["killed"] / total["tried"]
    print(f"{total['killed']} of {total['tried']} mutants killed, {share:.1%}")
    sys.exit(share < LEAST_KILLED)


if __name__ == "__main__":
    main()

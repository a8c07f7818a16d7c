"""Run the commands of pages from top to bottom as they are printed, as one person in a fresh folder with a fresh home.

    python scripts/walk.py research --log out/walks/research.txt    # one of USERS
    python scripts/walk.py docs/tutorials/two-devices.md    # as root: two namespaces joined by a veth
    python scripts/walk.py --venv .venv docs/how-to/notebook.md    # what a page leaves to another one: its environment

Prints each command with the last lines that it said (all of them go to the log) and how many are wider than a terminal, and exits with 1 if one
failed that the page lets succeed. The clone of a page is this repository; `apt` and ROS 2 from apt are left out; what serves until Ctrl-C gets it
where the page says so, or goes on. Blocks of the relay's and the ping's device run in a namespace each, and `ssh` from one reaches an sshd in the other.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

TOP = Path(__file__).parents[1]
PART = re.compile(
    r"^ *```(?P<language>\w+)\n(?P<text>.*?)^ *```$|^(?P<indented>(?: {4,}\S[^\n]*\n?)+)|^(?P<prose>[^\n]*\S[^\n]*)$",
    re.MULTILINE | re.DOTALL,
)
SERVES = re.compile(
    r"^(?:sudo )?dds-trace (?:record (?:relay|tap|beacon)\b(?!.*--duration)|bridge(?!.*--(?:check|config))|watch|studio)"
)
COMMAND = re.compile(r"^(?:sudo |\. |source |cd |tar |pip |uv |git |python3? |dds-|~/|PATH=|just |mkdir |DDS_|scp )")
NOT_HERE = re.compile(
    r"^sudo (?:apt|iw|cpupower|ip|mkdir|useradd|cp|systemctl)|^sudoedit|^docker |^dask |(?:--cluster|--host robot|mine\.xml)\b"
)
OF_APT = "/opt/ros/"
FETCHES = re.compile(r"git clone|pip install|just install")
MEANT = re.compile(r"--fail-if|--until|dds-trace bag |compare ")
"""A command whose answer may be an exit code of its own."""
WITH_WHEELS = re.compile(r"^.*# leave it out with wheels\n|(?<=\"rmw_fastrtps_cpp\"), [^\]]*(?=\])", re.MULTILINE)
WIDTH = 80
OUTPUTS = """python -c 'import json; [print(kind, len(str(data))) for cell in json.load(open("page.ipynb"))["cells"]
 for out in cell["outputs"] for kind, data in out.get("data", {out["output_type"]: out.get("text")}).items()]'"""
INSTALL = (
    "git clone https://github.com/OWNER/dds-trace",
    "cd dds-trace",
    "pip install --quiet --target .tools uv rust-just",
    'PATH="$PWD/.tools/bin:$PATH" just install',
    "source .venv/bin/activate",
)
SHORT = r"printf '[run]\nmessages = 100\nrepeats = 3\norder = \"alternating\"\n[axes]\nbackend = [\"ros2\", \"zenoh\"]\nrate = 50\n"
USERS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "first-answer": ((), ("docs/tutorials/first-answer.md",)),
    "boards": ((), ("docs/tutorials/two-devices.md",)),
    "bags": ((), ("docs/tutorials/bag.md",)),
    "research": (
        (*INSTALL, SHORT + 'size = "33KB"\n\' | tee plan.toml other.toml'),
        ("docs/how-to/sweep.md", "docs/how-to/analyze.md", "docs/how-to/tables.md"),
    ),
    "ci": (
        (
            *INSTALL,
            "sed -n '/\\[run\\]/,/rate = 100/s/^ *//p' docs/how-to/ci.md > plan.toml",
            "mkdir main; cp plan.toml main/",
            "dds-trace sweep plan.toml --out runs --against SAME",
            "ln -s runs/plan-against-same/base base; ln -s runs/plan-against-same/new new",
        ),
        ("docs/how-to/ci.md",),
    ),
    "notebook": ((f"cp -r {TOP}/sample_traces/losses runs",), ("docs/how-to/notebook.md",)),
    "bad-link": (
        (
            *(*INSTALL, SHORT + 'size = "502KB"\n\' > plan.toml', "dds-trace sweep plan.toml --out runs"),
            "sed -i 's/^seconds = 3/seconds = 1/; s/^repeats = 5/repeats = 3/' plans/explain.toml",
        ),
        ("docs/how-to/choose.md",),
    ),
}
"""Kind of user -> what another page left there, and the pages, each of which goes on where the last one ended."""
PING, RELAY = "192.168.0.10", "192.168.0.20"


class Log:
    """What a person reads: a part on the screen, all of it in a file."""

    def __init__(self, path: Path | None) -> None:
        self.failed = 0
        self.last = ""
        self._file = None
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("w", encoding="utf-8")

    def note(self, line: str, said: str = "") -> None:
        print(line, flush=True)
        lines = said.strip().splitlines()
        for text in lines[-6:]:
            print(f"    {text[:160]}")
        if wide := sum(len(text) > WIDTH for text in lines):
            print(f"    ({wide} of {len(lines)} lines are wider than {WIDTH} columns)")
        self.last = next((text for text in reversed(lines) if text.strip()), self.last)
        if self._file is not None:
            print(line, *(f"    {text}" for text in lines), sep="\n", file=self._file, flush=True)


@dataclass
class Terminal:
    """A person's terminal: its folder, its variables, the way into its device, and what still serves in others."""

    folder: Path
    state: str
    log: Log
    enter: Sequence[str] = ()
    serving: list[tuple[str, subprocess.Popen[bytes], Path]] = field(default_factory=list)

    def run(self, line: str) -> None:
        """Run a line as the terminal was left."""
        keep = (
            f"status=$?; {{ declare -px; printf 'cd %q\\n' \"$PWD\"; }} > {shlex.quote(str(self._kept))}; exit $status"
        )
        began_s, enter = time.monotonic(), () if FETCHES.search(line) else self.enter
        done = subprocess.run(
            [*enter, "bash", "-c", f"{self.state}\n{line}\n{keep}"],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
            cwd=self.folder,
            timeout=2400,
        )
        if self._kept.is_file():
            self.state = self._kept.read_text(encoding="utf-8")
        self.report(line, done.returncode, done.stdout + done.stderr, time.monotonic() - began_s)

    def serve(self, line: str) -> None:
        """Start what goes on until Ctrl-C, in a terminal of its own."""
        log = self.folder / f"serving-{time.monotonic_ns()}.log"
        with log.open("wb") as out:
            process = subprocess.Popen(
                [*self.enter, "bash", "-c", f"{self.state}\nexec {line}"],
                stdout=out,
                stderr=out,
                cwd=self.folder,
                start_new_session=True,
            )
        self.serving.append((line, process, log))
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline and process.poll() is None and not log.stat().st_size:
            time.sleep(0.2)
        time.sleep(3)

    def end(self) -> None:
        """Press Ctrl-C in each terminal that serves."""
        for line, process, log in self.serving:
            process.send_signal(signal.SIGINT)
            status = process.wait(60)
            ended = 0 if status == 128 + signal.SIGINT else status  # as a search ends, which can be continued
            self.report(f"{line}  # until Ctrl-C", ended, log.read_text(encoding="utf-8"))
        self.serving.clear()

    def report(self, line: str, status: int, said: str, seconds: float = 0) -> None:
        """Note a command, its status, and what it said."""
        names_what_lacks = status == 10 and "pip install 'dds-trace[" in said
        is_wrong = status != 0 and not MEANT.search(line) and not names_what_lacks
        self.log.failed += is_wrong
        self.log.note(f"{'FAILED' if is_wrong else 'ok'} {status} ({seconds:.0f} s) $ {line}", said)

    def write(self, name: str, text: str) -> None:
        """Save a file in the folder in which the terminal was left."""
        here = Path(shlex.split(self.state.rpartition("\ncd ")[2])[0])
        (here / name).write_text(text, encoding="utf-8")

    @property
    def _kept(self) -> Path:
        return self.folder / ".state"


def commands_of(text: str) -> list[str]:
    """Return the commands of a block, a continued one in one line."""
    lines = re.sub(r"\\\n\s*", "", text).splitlines()
    return [re.sub(r"\s{2,}#.*$", "", line.strip()) for line in lines if COMMAND.match(line.strip())]


def walk(page: Path, terminals: dict[str, Terminal]) -> None:
    """Follow a page: `ping` is the person's terminal, `relay` one on the other device."""
    ping, plan, cells = terminals["ping"], "", []
    for part in PART.finditer(page.read_text(encoding="utf-8")):
        prose, text = part["prose"] or "", part["text"] or part["indented"] or ""
        plan = next(reversed(re.findall(r"`(?:[^`]* )?(?:\w+/)*([\w-]+\.toml)`", prose)), plan)
        read(prose, terminals)
        if plan and (part["language"] == "toml" or re.match(r"\s+\[\w+\]", part["indented"] or "")):
            ping.write(plan, WITH_WHEELS.sub("", textwrap.dedent(text)))
        elif part["language"] == "python":
            cells.append(text)
        elif part["indented"] or part["language"] == "sh":
            follow(text, terminals["relay" if text.startswith("# relay's device") else "ping"])
    read("## ", terminals)
    if cells and "jupyter" not in page.read_text(encoding="utf-8"):
        ping.write("page.py", "\n".join(cells))
        ping.run("python page.py")
    elif cells:
        one = {"cell_type": "code", "execution_count": None, "metadata": {}, "outputs": []}
        filled = [{**one, "source": cell} for cell in cells]
        ping.write("page.ipynb", json.dumps({"cells": filled, "metadata": {}, "nbformat": 4, "nbformat_minor": 4}))
        ping.run(f"jupyter execute page.ipynb --inplace && {OUTPUTS}")


def read(prose: str, terminals: dict[str, Terminal]) -> None:
    """Do in each terminal what a sentence asks for: end what serves, begin as each terminal begins."""
    begins = re.search(r"(?:[Ee]very|[Ee]ach) terminal begins with `([^`]+)`", prose)
    for terminal in terminals.values():
        if prose.startswith("## ") or ("Ctrl-C" in prose and "until" not in prose):
            terminal.end()
        if begins:
            terminal.run(begins[1])


def follow(text: str, terminal: Terminal) -> None:
    """Run the commands of a block."""
    is_of_apt = OF_APT in text and not Path(OF_APT).is_dir()
    for line in commands_of(text):
        if NOT_HERE.search(line) or is_of_apt:
            terminal.log.note(f"left out $ {line}")
        elif SERVES.match(line):
            terminal.serve(line)
        else:
            terminal.run(line)


def new_home(home: Path, **more: str) -> str:
    """Return the lines that a shell of a person with a fresh home begins with."""
    programs = {"sudo": 'exec "$@"', **more}  # whoever runs this is root, or has no link to emulate
    (home / "bin").mkdir(parents=True, exist_ok=True)
    for name, line in programs.items():
        (home / "bin" / name).write_text(f"#!/bin/bash\n{line}\n", encoding="utf-8")
        (home / "bin" / name).chmod(0o755)
    clone = {"GIT_CONFIG_COUNT": "1", "GIT_CONFIG_KEY_0": f"url.{TOP}.insteadOf"}
    clone["GIT_CONFIG_VALUE_0"] = "https://github.com/OWNER/dds-trace"
    variables = {"HOME": str(home), "COLUMNS": str(WIDTH), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **clone}
    caches = {"PIP_CACHE_DIR": "~/.cache/pip", "UV_CACHE_DIR": "~/.cache/uv"}
    variables |= {name: str(Path(path).expanduser()) for name, path in caches.items()}
    state = "\n".join(f"export {name}={shlex.quote(value)}" for name, value in variables.items())
    return f"{state}\nexport PATH={shlex.quote(str(home / 'bin'))}:$PATH"


@contextmanager
def two_devices(folder: Path, log: Log) -> Iterator[dict[str, Terminal]]:
    """Two namespaces that are the ping's and the relay's device; both install alike, so the relay has the ping's environment."""
    sys.path.insert(0, str(TOP / "tests/support"))
    import loopback_sshd  # noqa: PLC0415 - a page of two devices
    import two_devices as tested  # noqa: PLC0415

    with tested.two_devices(folder, PING, RELAY) as (_, devices):
        homes = {name: device.folder for name, device in devices.items()}
        (folder / "sshd").mkdir()
        server = loopback_sshd.sshd(folder / "sshd", shlex.join(devices["relay"].enter))
        inside = f"cd {homes['relay']}; export HOME={homes['relay']}"
        with (folder / "sshd/sshd_config").open("a", encoding="utf-8") as options:
            options.write(f'ForceCommand {inside}; [ -z "$SSH_ORIGINAL_COMMAND" ] || eval "$SSH_ORIGINAL_COMMAND"\n')
        user = server.destination.partition("@")[0]
        words = f'{shlex.join(server.options)} "${{@/#pi@/{user}@}}"'
        programs = {"ssh": f"exec {shutil.which('ssh')} {words}", "scp": f"exec {shutil.which('scp')} -O {words}"}
        (homes["relay"] / "dds-trace-env").symlink_to(homes["ping"] / "dds-trace-env")
        yield {
            name: Terminal(
                home,
                new_home(home, **programs) + f"\nunset ROS_AUTOMATIC_DISCOVERY_RANGE\ncd {home}",
                log,
                device.enter,
            )
            for (name, device), home in zip(devices.items(), homes.values(), strict=True)
        }


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("pages", nargs="+", help=f"one person's path, or one of {', '.join(USERS)}")
    parser.add_argument("--venv", type=Path, help="an environment that is there, for pages that do not install one")
    parser.add_argument("--before", default="", help="what the pages expect to be there: shell commands run first")
    parser.add_argument("--log", type=Path, help="every line that was said")
    given = parser.parse_args()
    before, pages = USERS.get(given.pages[0], (filter(None, given.before.split(" ;; ")), given.pages))
    given.before, given.pages = [*before], [TOP / page for page in pages]
    log = Log(given.log)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        is_of_two = any("# relay's device" in page.read_text(encoding="utf-8") for page in given.pages)
        if is_of_two or os.geteuid() == 0:  # a machine of one's own: its ports and domains are free
            with two_devices(folder, log) as terminals:
                go(given, terminals if is_of_two else {"ping": terminals["ping"]})
        else:
            go(given, {"ping": Terminal(folder, f"{new_home(folder / 'home')}\ncd {shlex.quote(name)}", log)})
    names = " ".join(pages)
    log.note(f"{names}: {log.failed} failed" if log.failed else f"{names}: walked")
    log.note(f"last: {log.last.strip()}")
    return int(log.failed > 0)


def go(given: argparse.Namespace, terminals: dict[str, Terminal]) -> None:
    """Walk the pages in terminals with what they expect."""
    for terminal in terminals.values():
        if given.venv:
            terminal.run(f". {shlex.quote(str(given.venv.resolve() / 'bin/activate'))}")
    for line in given.before:
        terminals["ping"].run(line)
    for page in given.pages:
        walk(page, terminals)


if __name__ == "__main__":
    sys.exit(main())

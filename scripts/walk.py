"""Run the commands of a page from top to bottom as they are printed, in a fresh folder with a fresh home.

    python scripts/walk.py docs/tutorials/bag.md
    python scripts/walk.py --venv .venv docs/how-to/notebook.md    # what a page leaves to another one: its environment

Prints each command with the last lines that it said, and exits with 1 if one failed that the page lets succeed. The clone of
the page is this repository; `apt` is left out; what serves until Ctrl-C gets it where the page says so, or goes on.
"""

from __future__ import annotations

import argparse
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

TOP = Path(__file__).parents[1]
PART = re.compile(
    r"^ *```(?P<language>\w+)\n(?P<text>.*?)^ *```$|^(?P<indented>(?: {4,}\S[^\n]*\n?)+)|^(?P<prose>[^\n]*\S[^\n]*)$",
    re.MULTILINE | re.DOTALL,
)
SERVES = re.compile(r"^(?:sudo )?dds-trace (?:record (?:relay|tap|beacon)\b(?!.*--duration)|bridge|watch|studio)")
COMMAND = re.compile(r"^(?:sudo |\. |source |cd |tar |pip |uv |git |python3? |dds-|~/|PATH=|just |mkdir |DDS_)")
NOT_HERE = re.compile(r"^sudo (?:apt|iw|cpupower|ip|useradd|cp|systemctl)|^sudoedit|^scp |^docker ")
MEANT = re.compile(r"--fail-if|dds-trace bag |compare ")
"""A command whose answer may be an exit code of its own."""


@dataclass
class Walk:
    """A person's terminal: its folder, its variables, and what still serves in others."""

    folder: Path
    state: str
    failed: int = 0
    serving: list[tuple[str, subprocess.Popen[bytes], Path]] = field(default_factory=list)

    def shell(self, line: str) -> tuple[int, str]:
        """Run a line in the terminal as it was left; return its status and what it said."""
        keep = "status=$?; { declare -px; printf 'cd %q\\n' \"$PWD\"; } > .state.new; exit $status"
        whole = f"{self.state}\n{line}\n{keep.replace('.state.new', shlex.quote(str(self.folder / '.state')))}"
        done = subprocess.run(
            ["bash", "-c", whole], capture_output=True, text=True, check=False, cwd=self.folder, timeout=1800
        )
        if (self.folder / ".state").is_file():
            self.state = (self.folder / ".state").read_text(encoding="utf-8")
        return done.returncode, done.stdout + done.stderr

    def serve(self, line: str) -> None:
        """Start what goes on until Ctrl-C, in a terminal of its own."""
        log = self.folder / f"serving-{time.monotonic_ns()}.log"
        with log.open("wb") as out:
            process = subprocess.Popen(
                ["bash", "-c", f"{self.state}\nexec {line}"],
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
            self.report(line, status, log.read_text(encoding="utf-8"))
        self.serving.clear()

    def report(self, line: str, status: int, said: str) -> None:
        """Print a command, its status, and its last lines."""
        names_what_lacks = status == 10 and "pip install 'dds-trace[" in said
        is_wrong = status != 0 and not MEANT.search(line) and not names_what_lacks
        self.failed += is_wrong
        print(f"{'FAILED' if is_wrong else 'ok'} {status} $ {line}")
        for text in said.strip().splitlines()[-6:]:
            print(f"    {text[:160]}")
        sys.stdout.flush()


def commands_of(text: str) -> list[str]:
    """Return the commands of a block, a continued one in one line."""
    lines = re.sub(r"\\\n\s*", "", text).splitlines()
    return [re.sub(r"\s{2,}#.*$", "", line.strip()) for line in lines if COMMAND.match(line.strip())]


def walk(page: Path, terminal: Walk) -> int:
    """Follow a page; return how many commands failed."""
    plan, cells = "", []
    for part in PART.finditer(page.read_text(encoding="utf-8")):
        prose, text = part["prose"] or "", part["text"] or part["indented"] or ""
        plan = next(reversed(re.findall(r"`(?:\w+/)*([\w-]+\.toml)`", prose)), plan)
        if prose.startswith("## ") or ("Ctrl-C" in prose and "until" not in prose):
            terminal.end()
        if part["language"] == "toml" and plan:
            (terminal.folder / plan).write_text(text, encoding="utf-8")
        elif part["language"] == "python":
            cells.append(text)
        elif part["indented"] or part["language"] == "sh":
            follow(text, terminal)
    terminal.end()
    if cells:
        (terminal.folder / "cells.py").write_text("\n".join(cells), encoding="utf-8")
        terminal.report("python cells.py", *terminal.shell("python cells.py"))
    return terminal.failed


def follow(text: str, terminal: Walk) -> None:
    """Run the commands of a block."""
    for line in commands_of(text):
        if NOT_HERE.match(line):
            print(f"left out $ {line}")
        elif SERVES.match(line):
            terminal.serve(line)
        else:
            terminal.report(line, *terminal.shell(line))


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("page", type=Path)
    parser.add_argument("--venv", type=Path, help="an environment that is there, for pages that do not install one")
    parser.add_argument("--before", default="", help="what the page expects to be there: shell commands run first")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        home, sudo = Path(folder, "home"), Path(folder, "home/bin/sudo")
        sudo.parent.mkdir(parents=True)
        sudo.write_text(
            '#!/bin/sh\nexec "$@"\n', encoding="utf-8"
        )  # whoever runs this is root, or has no link to emulate
        sudo.chmod(0o755)
        clone = {"GIT_CONFIG_COUNT": "1", "GIT_CONFIG_KEY_0": f"url.{TOP}.insteadOf"}
        clone["GIT_CONFIG_VALUE_0"] = "https://github.com/OWNER/dds-trace"
        variables = {"HOME": str(home), "COLUMNS": "80", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", **clone}
        caches = {"PIP_CACHE_DIR": "~/.cache/pip", "UV_CACHE_DIR": "~/.cache/uv"}
        variables |= {name: str(Path(path).expanduser()) for name, path in caches.items()}
        state = "\n".join(f"export {name}={shlex.quote(value)}" for name, value in variables.items())
        state += f"\nexport PATH={shlex.quote(str(sudo.parent))}:$PATH"
        if given.venv:
            state += f"\n. {shlex.quote(str(given.venv.resolve() / 'bin/activate'))}"
        terminal = Walk(Path(folder), f"{state}\ncd {shlex.quote(folder)}")
        for line in filter(None, given.before.split(" ;; ")):
            terminal.report(line, *terminal.shell(line))
        failed = walk(given.page, terminal)
    print(f"{given.page}: {failed} failed" if failed else f"{given.page}: walked")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())

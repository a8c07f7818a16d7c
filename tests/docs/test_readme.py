"""README's command lines run, taken out of the file in their order and with one state: only what is long is made short.

The further commands of a first hour are those of the tutorials, which tests/docs/test_examples.py and test_two_devices.py run.
"""

import re
import shlex
import signal
import sys
from contextlib import ExitStack
from importlib.metadata import entry_points
from pathlib import Path

import pytest
from processes import RunningCommand

from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.campaigns.plan.plan_file import read_plan

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
LINE = re.compile(
    r"^ {4}(?P<block>(?:dds-|pip|just).+)$|`(?P<inline>(?:dds-trace |pipx? |just )[^`\n]+)`", re.MULTILINE
)
LINES = [re.sub(r"\s{2,}#.*$", "", found["block"] or found["inline"]) for found in LINE.finditer(README)]

NOT_RUN = {
    "pip install --target .tools uv rust-just": "needs the index; the demo takes minutes: tests/extensions/campaigns/commands/test_sweep.py holds its plan, tests/cli its two commands",
    "dds-trace sweep plans/quick.toml --out runs/": "minutes; its plan is read here, and tests/extensions/campaigns runs sweeps",
    "pip install '.[analyze]'": "needs the index: scripts/check_release.py installs each extra alone",
    "just docs": "tests/docs/test_site.py builds the site",
}
"""Line that is not run -> why."""

SHORT = ["--messages", "5", "--warmup", "1", "--rate", "100", "-o", "own_cost=false", "--backend", "socket"]
"""Behind the line of a ping: few messages, and over sockets, since those over ROS 2 are the business of other tests."""


def test_the_readme_is_read_in_thirty_seconds_and_installs_beside_an_externally_managed_python():
    assert len(README.split()) <= 500
    assert (README.count("```"), README.count("![")) == (2, 1)
    assert len(re.findall(r"\]\(", README)) <= 12
    assert "git clone" in README
    assert not re.search(r"pip install (?!--target)(?!'\.\[)", README)


def test_what_is_not_run_stands_in_the_readme():
    assert [line for line in NOT_RUN if line not in LINES] == []
    assert len([line for line in LINES if line not in NOT_RUN]) >= 4
    for line in (line for line in NOT_RUN if line.startswith("dds-trace sweep")):
        assert read_plan(ROOT / shlex.split(line)[2]).cells


@pytest.mark.middleware
def test_every_command_line_of_the_readme_runs(tmp_path, monkeypatch, domain_id, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
    with ExitStack() as stack:
        relay = None
        for line in (line for line in LINES if line not in NOT_RUN):
            program, *words = shlex.split(line)
            if words[0] == "record":
                command = RunningCommand(program, *words, *(SHORT[-4:] if "relay" in words else SHORT))
                stack.callback(command.clean_up)
                if "relay" in words:
                    relay = command
                    relay.wait_for_line("serves domain")
                else:
                    done = command.finish()
                    assert done.status == 0, (line, done.stderr)
                continue
            if relay is not None:
                assert relay.stop(signal.SIGINT).status == 0
                relay = None
            monkeypatch.setattr(sys, "argv", [program, *words])
            with pytest.raises(SystemExit) as ended:
                entry_points(group="console_scripts", name=program)[program].load()()
            assert ended.value.code in (0, None), (line, capsys.readouterr().err)
    assert sorted(path.name for path in Path("runs/analysis").iterdir()) == [
        "report.html",
        "roundtrips.parquet",
        "summary.parquet",
    ]
    assert set(analyze("runs").summary["received"]) == {5}

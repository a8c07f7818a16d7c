import html
import re

import pytest
from campaigns import write_run
from commands import run_main, run_trace
from trace_files import evenly

from dds_trace import analyze

MS = 1_000_000
MESSAGES = 300
JUDGED = re.compile(
    r"(?<!no proven )\b(better|worse|faster|fastest|slower|slowest|quicker|quickest|wins|winner)\b(?!\":)",
    re.IGNORECASE,
)
WAYS = {  # vendor, bridge, one way: two middlewares in one domain, and one of them through a bridge
    "fastdds": ("fastdds", "none", MS),
    "cyclonedds": ("cyclonedds", "none", 4 * MS),
    "bridged": ("fastdds", "builtin", 9 * MS),
}


def record(folder, runs, slower=1.0):
    """Runs of every way of `WAYS`, one after the other and 1 % apart."""
    number = 0
    for name, (vendor, bridge, way_ns) in WAYS.items():
        for repeat in range(runs):
            ways = [int(way_ns * slower * (1 + 0.01 * repeat)) + (s * 37 % 101) * 1000 for s in range(MESSAGES)]
            domain_id = 5 if bridge == "none" else 10
            write_run(
                folder / f"{name}-{repeat}",
                number,
                evenly(ways, start_ns=number * 1000 * 100 * MS),
                ping={"vendor": vendor, "rmw": None},
                relay={"vendor": vendor, "relay_id": 900 + number, "domain_id": domain_id, "rmw": None},
                bridge=bridge,
                relay_domain_id=domain_id,
            )
            number += 1
    return folder


def without_program(page):
    """The page without the scripts that draw it; its data and its words stay."""
    kept = re.sub(r"<script>.*?</script>|<style>.*?</style>", "", page, flags=re.DOTALL)
    return html.unescape(re.sub(r"<[^>]+>", " ", kept))


def every_output(folder, slow, capsys):
    """What every report of a campaign says, and every report of its comparison with a slower one: name -> text."""
    job = ("--size", "33KB", "--rate", "10", "--deadline", "50ms", "--reliability", "0.9")
    kinds = [part for kind in ("html", "md", "json", "terminal") for part in ("--report", kind)]
    assert run_main(folder, *kinds, "--all", "--deadline", "20ms") == 0
    outputs = {"terminal": capsys.readouterr().out}
    files = {path.suffix[1:]: path.read_text() for path in (folder / "analysis").glob("report.*")}
    outputs |= files | {"html": without_program(files["html"])}
    assert run_trace("choose", folder, "--report", "json", *job) == 0
    outputs["recommend"] = capsys.readouterr().out
    for kind in ("terminal", "md", "json", "junit", "html"):
        run_main("compare", folder, slow, "--fail-if", "default", "--report", kind)
        shown = "".join(capsys.readouterr())
        outputs[f"compare {kind}"] = without_program(shown) if kind == "html" else shown
    analysis = analyze(folder)
    outputs["notebook"] = getattr(analysis, "_repr_html_", analysis.__repr__)()
    return outputs


@pytest.mark.keeps(1)
@pytest.mark.parametrize("runs", [1, 2])
def test_no_output_tells_apart_what_rests_on_one_or_two_runs(tmp_path, capsys, runs):
    outputs = every_output(record(tmp_path / "runs", runs), record(tmp_path / "slow", runs, slower=3), capsys)
    assert set(outputs) == {
        "terminal", "html", "md", "json", "recommend", "notebook",
        "compare terminal", "compare md", "compare json", "compare junit", "compare html"
    }  # fmt: skip
    for name, text in outputs.items():
        assert len(text) > 200, name
        judged = [text[max(0, m.start() - 60) : m.end() + 30] for m in JUDGED.finditer(text)]
        assert judged == [], f"{name} with {runs} runs"
        assert "regressed" not in text, name
    for name in ("terminal", "html", "md"):
        words = " ".join(outputs[name].split())
        assert f"needs 3 runs of each, there {'is 1' if runs == 1 else 'are 2'}" in words, name
    assert "likely" in outputs["recommend"]
    assert "meets" not in outputs["recommend"]


@pytest.mark.thorough
def test_with_three_runs_the_same_outputs_do_tell(tmp_path, capsys):
    outputs = every_output(record(tmp_path / "runs", 3), record(tmp_path / "slow", 3, slower=3), capsys)
    for name in ("terminal", "html", "md", "json", "compare terminal", "compare json", "compare html"):
        assert JUDGED.search(outputs[name]), name
    assert "regressed" in outputs["compare terminal"]
    assert "failure" in outputs["compare junit"]
    assert "meets the deadline of 50 ms" in outputs["recommend"]

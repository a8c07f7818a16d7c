"""The steps of an answer with made runs; test_real_answer.py has real ones."""

import json
import math
import re
from collections import Counter, defaultdict
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest

from dds_trace.extensions.campaigns import answer as module
from dds_trace.extensions.campaigns.answer import Search, new_folder, promise
from dds_trace.extensions.campaigns.commands.advise import shown
from dds_trace.extensions.campaigns.halving import Look
from dds_trace.extensions.campaigns.plan.link import Link
from dds_trace.extensions.campaigns.plan.plan_file import parse_plan
from dds_trace.extensions.campaigns.question import Question, find_candidates, flows_together, limits_of
from dds_trace.extensions.campaigns.trials import Durations

PLAN = '[axes]\nbackend = ["cyclonedds", "zenoh"]\nsize = "145KB"\nrate = 20\n'
LINK = Link("made", rate_mbit_s=100, delay_ms=2, loss_percent=0.1)


class Desk:
    """Runs by a function of the candidate: its response in ms, and its share of losses; `more_s` is what they take beyond 3 s and their length."""

    def __init__(self, response_ms, lost=lambda _: 0.0, more_s=lambda *_: 0.0):
        self.response_ms, self.lost, self.more_s = response_ms, lost, more_s
        self.now_s, self.events, self.looks, self.late_s, self.seconds = 0.0, [], [], [], []
        self.random = np.random.default_rng(0)

    @contextmanager
    def open(self, plan, _folder, _note, _seconds, overheads_s):
        self.stage, self.durations = plan.name, Durations(plan, overheads_s)
        yield self

    def look(self, candidate, number, seconds):
        took_s = 3 + self.more_s(len(self.looks), self.random) + seconds * len(candidate.cells)
        self.late_s.append(took_s - self.expected_s(candidate, seconds))
        self.durations.took(candidate, seconds, took_s)
        self.now_s += took_s
        self.looks.append((self.stage, candidate, number))
        self.seconds.append(seconds)
        values = self.response_ms(candidate) * self.random.lognormal(0, 0.05, (len(candidate.cells), 200))
        values[self.random.random(values.shape) < self.lost(candidate)] = math.inf
        return Look(tuple(values))

    def expected_s(self, candidate, seconds):
        return self.durations.expected_s(candidate, seconds)

    def search(self, folder, link=LINK, text=PLAN, minutes=10.0, **limits):
        plan = replace(parse_plan(text, "asked", "asked.toml"), link=link, namespaces=link is not None)
        question = Question(plan, limits_of(**limits), minutes)
        return Search(question, folder, self.events.append, lambda: self.now_s, self.open)


def made_proofs(monkeypatch, verdicts):
    monkeypatch.setattr(
        module,
        "proof_of",
        lambda _name, base, _new: (
            {"verdict": verdicts[base.name], "kept": verdicts[base.name] == "better"}
            | {"reason": "made", "proof": [], "received": [], "ignored": []}
        ),
    )


MEDIANS = {"Cyclone DDS default": 30, "Cyclone DDS small-packets": 10, "Zenoh default": 14}


def median(candidate):
    return MEDIANS.get(candidate.name, 60.0)


@pytest.mark.parametrize(
    ("against_default", "against_other", "recommended"),
    [
        ("better", "better", "small-packets"),
        ("better", "no difference", "small-packets"),
        ("no difference", "better", ""),
        ("worse", "better", ""),
    ],
)
def test_the_best_is_used_where_it_is_proven_and_else_the_default(
    tmp_path, monkeypatch, sentences, against_default, against_other, recommended
):
    made_proofs(monkeypatch, {"Cyclone-DDS-default": against_default, "Zenoh-default": against_other})
    desk = Desk(median)
    found = desk.search(tmp_path, deadline="50ms").answer()
    assert (found["recommended"]["vendor"], found["recommended"]["bundle"]) == ("cyclonedds", recommended)
    assert [proof["against"] for proof in found["proofs"]] == ["Cyclone DDS default", "Zenoh default"]
    proofs = [(candidate.name, number) for stage, candidate, number in desk.looks if stage == "proof"]
    assert sorted({name for name, _ in proofs}) == sorted(MEDIANS)
    assert len(proofs) == 3 * module.PROOFS
    assert proofs[:6] == [*proofs[:3], *((name, 2) for name, _ in reversed(proofs[:3]))]
    assert json.loads((tmp_path / "answer.json").read_text())["sentence"] == found["sentence"] == desk.events[-1].text
    for name in ["CYCLONEDDS_URI"] * bool(recommended) + ["RMW_IMPLEMENTATION"]:
        assert f"  export {name}=" in "\n".join(shown(found))
    sentences(found["sentence"])


def test_what_breaks_a_limit_in_the_fresh_runs_is_not_used(tmp_path, monkeypatch):
    made_proofs(monkeypatch, dict.fromkeys(("Cyclone-DDS-default", "Zenoh-default"), "better"))
    desk = Desk(median)
    desk.lost = lambda candidate: 0.1 * (desk.stage == "proof" and candidate.bundle == "small-packets")
    found = desk.search(tmp_path).answer()
    assert found["recommended"]["middleware"] == "Zenoh"
    assert "small-packets breaks a limit" in found["sentence"]
    desk.lost = lambda _: 0.1 * (desk.stage == "proof")
    found = desk.search(tmp_path).answer()
    assert found["fits"]
    assert "nearest: 10" in found["sentence"] or "nearest: 9" in found["sentence"]


SIDES = ("Cyclone DDS default", "Cyclone DDS buffers", "Cyclone DDS small-packets", "Zenoh default")


@pytest.mark.parametrize(
    ("looks_ms", "fresh_ms", "verdicts", "used"),
    [
        ((30, 60, 10, 14), (30, 60, 10, 14), {0: "better", 3: "worse"}, 3),
        ((30, 60, 10, 14), (30, 60, 10, 9), {0: "better", 3: "no difference"}, 3),
        *(((10, 11, 60, 60), (10, 9, 60, 60), {1: verdict}, 0) for verdict in ("no difference", "mixed", "better")),
        ((10, 11, 60, 60), (10, 9, 60, 60), {1: "worse"}, 1),
        ((60, 60, 11, 10), (60, 60, 9, 10), {2: "no difference"}, 3),
        ((11, 12, 10, 60), (11, 9, 10, 60), {0: "no difference", 1: "no difference"}, 0),
    ],
)
def test_another_middleware_is_used_where_it_is_faster_and_a_bundle_instead_of_its_default_by_proof_alone(
    tmp_path, monkeypatch, looks_ms, fresh_ms, verdicts, used
):
    made_proofs(monkeypatch, {SIDES[number].replace(" ", "-"): verdict for number, verdict in verdicts.items()})
    times = {"looks": dict(zip(SIDES, looks_ms, strict=True)), "proof": dict(zip(SIDES, fresh_ms, strict=True))}
    desk = Desk(lambda one: times[desk.stage].get(one.name, 80))
    sentence = desk.search(tmp_path).answer()["sentence"]
    assert sentence.startswith(f"Use {SIDES[used]}:")
    assert ("no difference" in sentence) == ("no difference" in verdicts.values())


MORE_S = {
    "none": lambda *_: 0,
    "always 12 s": lambda *_: 12,
    "by chance": lambda _, random: random.exponential(6),
    "some stand still": lambda _, random: 40 * (random.random() < 0.1),
}


@pytest.mark.parametrize("minutes", [2, 3, 8, 20])
@pytest.mark.parametrize("more", MORE_S)
@pytest.mark.parametrize("kind", ["fits", "breaks a limit", "more than the link carries"])
def test_no_step_begins_that_would_not_end_in_the_time_that_was_given(tmp_path, monkeypatch, minutes, more, kind):
    """Searching, proving, and the search for what fits: only a run that takes longer than those before it ends late."""
    made_proofs(monkeypatch, defaultdict(lambda: "no difference"))
    desk = Desk(
        lambda one: 500 if kind == "breaks a limit" and one.cells[0].rate > 4 else median(one), more_s=MORE_S[more]
    )
    link = replace(LINK, rate_mbit_s=10) if kind.startswith("more") else LINK
    found = desk.search(tmp_path, link, minutes=minutes, deadline="100ms").answer()
    assert desk.now_s <= 60 * minutes + max(0, *desk.late_s[2:])
    proofs = Counter(candidate.name for stage, candidate, _ in desk.looks if stage == "proof")
    assert found["recommended" if kind == "fits" else "fits"] is not None
    untried = sum("not tried" in one["dropped"] for one in found["candidates"])
    assert (f"{untried} more setup" in found["sentence"]) == (not kind.startswith("more") and untried > 0)
    short = [one["candidate"]["name"] for one in found["candidates"] if "no time for more" in one["dropped"]]
    is_said = kind == "fits" and bool({*short} - {*proofs})
    assert ("for more runs" in found["sentence"]) == is_said
    assert untried <= 3 or more != "none"  # of 10: the first looks have half of the time
    if kind == "fits" and minutes >= 8:
        assert min(proofs.values()) >= module.LEAST_PROOFS


def test_without_time_for_a_proof_the_default_is_used_and_the_sentence_says_so(tmp_path):
    desk = Desk(median, more_s=lambda *_: 100 if desk.stage == "proof" else 0)
    found = desk.search(tmp_path, minutes=3).answer()
    assert found["recommended"]["bundle"] == ""
    assert {proof["verdict"] for proof in found["proofs"]} == {"incomplete"}
    assert "not compared with" in found["sentence"]


@pytest.mark.parametrize(
    ("loss", "burst", "bundle"),
    [(0, 0, ""), (0.1, 0, ""), (3, 0, "small-packets"), (3, 8, ""), (30, 8, "small-packets")],
)
def test_where_the_link_loses_split_datagrams_the_first_looks_are_of_small_ones(
    tmp_path, monkeypatch, loss, burst, bundle
):
    """In two minutes there is time for two; the default, which had none, is then a side of the proof."""
    made_proofs(monkeypatch, defaultdict(lambda: "no difference"))
    desk = Desk(median, more_s=lambda *_: 12)
    desk.lost = lambda one: 0.5 * (bool(bundle) and one.vendor == "cyclonedds" and "small-packets" not in one.bundle)
    link = replace(LINK, loss_percent=loss, loss_burst=burst)
    found = desk.search(tmp_path, link, minutes=2).answer()
    assert {(one.vendor, one.bundle) for _, one, _ in desk.looks[:2]} == {("cyclonedds", bundle), ("zenoh", "")}
    if bundle:
        assert found["recommended"]["bundle"] == bundle
        assert ("proof", "Cyclone DDS default") in {(stage, one.name) for stage, one, _ in desk.looks}
        assert "Cyclone DDS default breaks a limit" in found["sentence"]
        assert "(Cyclone DDS and Zenoh)" in found["sentence"]


def test_what_lost_most_in_the_first_looks_is_not_run_again(tmp_path, monkeypatch):
    made_proofs(monkeypatch, {"Zenoh-default": "better"})
    desk = Desk(median, lost=lambda one: one.name == "Cyclone DDS default")
    found = desk.search(tmp_path).answer()
    assert found["recommended"]["bundle"] == "small-packets"
    proven = {one.name for stage, one, _ in desk.looks if stage == "proof"}
    assert proven == {"Cyclone DDS small-packets", "Zenoh default"}
    (skipped,) = (proof for proof in found["proofs"] if proof["against"] not in proven)
    assert (skipped["kept"], skipped["verdict"]) == (True, "incomplete")
    assert "is out: 100.0% lost" in skipped["reason"]
    assert "breaks a limit, 100.0% lost" in found["sentence"]


FLOWS = """[run]\nseconds = 2\n[axes]\nbackend = ["cyclonedds", "zenoh"]
[[flows]]\nname = "camera"\nsize = "145KB"\nrate = 20
[[flows]]\nname = "imu"\ndata = "imu"\nrate = 100
[[flows]]\nname = "lidar"\nsize = "20KB"\nrate = 10
"""


def test_flows_are_asked_together_and_their_rates_fall_together(tmp_path):
    desk = Desk(median)
    search = desk.search(tmp_path, replace(LINK, rate_mbit_s=12), FLOWS)
    plan = flows_together(search.question.plan)
    search.question = replace(search.question, plan=plan)
    assert search.load == pytest.approx(24.8 / 12)
    assert 0 < promise(search.question)[1] <= 600
    found = search.answer()
    assert [message["flow"] for message in found["question"]["messages"]] == ["camera", "imu", "lidar"]
    rates = {tuple(cell.rate for cell in candidate.cells) for stage, candidate, _ in desk.looks if stage == "fit"}
    assert all(imu == pytest.approx(5 * camera, rel=0.02) for camera, imu, _ in rates if camera != 20)
    assert "in proportion" in found["sentence"]


def test_a_device_that_vanishes_is_not_a_load_that_does_not_fit(tmp_path):
    desk, runs, gone = Desk(median), range(3), Look(failure="robot: no route to host")
    measured = desk.look
    for is_there in (lambda: False, lambda: len(desk.looks) in runs, lambda: desk.stage == "looks"):
        desk.look = lambda *of, is_there=is_there: measured(*of) if is_there() else gone
        found = desk.search(tmp_path).answer()
        assert (found["recommended"], found["fits"]) == (None, None)
        assert "no route to host" in found["sentence"]
        assert "continues in" in shown(found)[-1]
        assert not (tmp_path / "answer.json").exists()


@pytest.mark.parametrize("most_bit_s", [2e6, 4e6, 9e6])
def test_where_nothing_fits_the_highest_rate_and_the_largest_size_are_searched(tmp_path, sentences, most_bit_s):
    def response(candidate):
        (cell,) = candidate.cells
        return 20 if cell.size * 8 * cell.rate <= most_bit_s else 500

    desk = Desk(response)
    found = desk.search(tmp_path, replace(LINK, rate_mbit_s=10), deadline="100ms").answer()
    assert found["load"] == pytest.approx(2.32)
    assert "no setting" in desk.events[1].text
    fits = found["fits"]
    assert fits["rate_hz"] <= most_bit_s / (8 * 145_000) <= fits["rate_hz"] * 1.21
    assert fits["size_bytes"] <= most_bit_s / (8 * 20) <= fits["size_bytes"] * 1.21
    assert not found["proofs"]
    assert desk.now_s <= 600
    if most_bit_s == 4e6:
        sentences(found["sentence"])
    for minutes in (2, 5):
        found = (
            Desk(response).search(tmp_path, replace(LINK, rate_mbit_s=10), minutes=minutes, deadline="100ms").answer()
        )
        assert any(found["fits"].values())


@pytest.mark.parametrize("most_hz", [0, 5])
def test_a_load_below_the_links_rate_that_nothing_carries_is_searched_too_and_settings_are_for_what_fits(
    tmp_path, most_hz
):
    desk = Desk(lambda one: (20 if one.cells[0].rate <= most_hz else 400) + 40 * (one.bundle != "small-packets"))
    found = desk.search(tmp_path, deadline="100ms").answer()
    lines = shown(found)
    assert 0.8 * most_hz <= (found["fits"]["rate_hz"] or 0) <= most_hz
    assert found["fits"]["size_bytes"] is None
    assert "was nearest" in found["sentence"]
    said = re.findall(r"no (rate|size) at [^(]+\(([^)]+)", found["sentence"])
    assert said == [("rate", "its time ran out")] * (not most_hz) + [("size", "all broke limits")]
    fit = [event.text for event in desk.events if event.stage == "fit" and event.state == "measured"]
    assert all(" at " in text and " Hz: p50" in text for text in fit)
    assert (found["recommended"] is not None) == ("Settings for what fits:" in lines) == bool(most_hz)
    assert any("export" in line for line in lines) == bool(most_hz)
    assert not any("`choose`" in line for line in lines)
    assert lines[-1].startswith("Wrote")


@pytest.mark.parametrize("minutes", [2, 3, 10, 30])
@pytest.mark.parametrize("link", [None, LINK])
def test_a_dry_run_promises_what_made_runs_take(tmp_path, minutes, link):
    recordings, seconds = promise(Desk(median).search(tmp_path, link, minutes=minutes).question)
    assert 0 < seconds <= 60 * minutes
    assert recordings >= 2 + 2 * module.LEAST_PROOFS
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("minutes", "least", "most"), [(2, 2, 2), (5, 3, 5), (20, 6, 6)])
def test_first_looks_are_as_long_as_two_of_each_candidate_have_time_for(tmp_path, minutes, least, most):
    search = (desk := Desk(median)).search(tmp_path, minutes=minutes)
    search.look(search.question.plan, LINK)
    assert least <= desk.seconds[0] <= most
    looked = Counter(candidate.name for _, candidate, _ in desk.looks)
    assert minutes == 2 or min(looked.values()) >= 2


def test_a_model_puts_the_candidates_in_order(tmp_path):
    desk = Desk(median)
    search = desk.search(tmp_path, minutes=1.0)
    search.order = lambda _, candidates: sorted(candidates, key=lambda one: one.bundle != "short-queue")
    ranking = search.look(search.question.plan, LINK)
    assert ranking[0].candidate in [candidate for _, candidate, _ in desk.looks]
    assert desk.looks[0][1].bundle == "short-queue"


def test_one_candidate_alone_is_measured_and_used(tmp_path):
    text = PLAN.replace('["cyclonedds", "zenoh"]', '"socket"')
    found = Desk(lambda _: 20).search(tmp_path, text=text, deadline="50ms").answer()
    assert (found["recommended"]["vendor"], found["recommended"]["variables"]) == ("socket", {})
    assert "nothing to compare it with" in found["sentence"]
    found = Desk(lambda _: 200).search(tmp_path, text=text, deadline="50ms").answer()
    assert found["fits"] == {"rate_hz": None, "size_bytes": None}


def test_what_cannot_run_is_out_and_named(tmp_path, monkeypatch):
    made_proofs(monkeypatch, {})
    desk = Desk(median)
    measured = desk.look
    desk.look = lambda one, *of: Look(failure="no licence") if one.vendor == "zenoh" else measured(one, *of)
    found = desk.search(tmp_path, text=PLAN.replace('"cyclonedds"', '"socket"')).answer()
    assert found["recommended"]["vendor"] == "socket"
    assert {row["dropped"] for row in found["candidates"][1:]} == {"no licence"}
    assert f"{len(found['candidates']) - 1} more setups could not run" in found["sentence"]
    desk.look = lambda *_: Look(failure="no licence")
    found = desk.search(tmp_path).answer()
    assert (found["recommended"], found["fits"]) == (None, None)
    assert "no licence" in found["sentence"]


def test_a_finished_answer_is_kept(tmp_path):
    assert new_folder(tmp_path, "a") == new_folder(tmp_path, "a") == tmp_path / "a"
    for name in ("a", "a-2"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "answer.json").write_text("{}")
    assert new_folder(tmp_path, "a").name == "a-3"


def test_defaults_are_tried_first_and_no_file_of_fast_dds_on_loopback(tmp_path):
    text = '[axes]\nbackend = ["ros2", "cyclonedds"]\nrmw = ["rmw_fastrtps_cpp"]\nsize = ["1KB", "9KB"]\n'
    plan = parse_plan(text.replace('"cyclonedds"', '"zenoh"').replace("rmw = ", "# "), "asked", "asked.toml")
    names = [(one.vendor, one.bundle) for one in find_candidates(plan, None, tmp_path)]
    assert names[:2] == [("fastdds", ""), ("zenoh", "")]
    assert [vendor for vendor, bundle in names if bundle] == ["zenoh"] * (len(names) - 2)
    assert all(len(one.cells) == 2 for one in find_candidates(plan, None, tmp_path))

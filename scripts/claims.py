"""The claims of the paper, asked of the rows that a sweep of plans/paper-claims.toml left: tables of docs/results/study.md.

python scripts/quoted.py runs/paper-claims   # keeps the rows of that sweep, and writes the tables
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from statistics import median
from typing import TYPE_CHECKING

from claim_pairs import (
    AIR,
    CONTRADICTED,
    CYCLONE,
    CYCLONE_ACROSS,
    FAST,
    FAST_ACROSS,
    LAPTOP,
    LARGE,
    LATE_MS,
    PI,
    SAME,
    SMALL,
    WIRED,
    WORDS,
    Asked,
    Pair,
    Row,
    Runs,
    measured,
    outcome,
    pairs_of,
    place_of,
    place_words,
    run_rows,
    runs_of,
    write_rows,
)
from stored_tables import STUDY, markdown

from dds_trace.analyzer.pipeline import analyze
from dds_trace.analyzer.verdicts.job import make_job
from dds_trace.analyzer.verdicts.recommend import Fit
from dds_trace.base.limits import DOMAIN_ID
from dds_trace.extensions.campaigns.plan.cells import AXES
from dds_trace.extensions.campaigns.plan.link import PRESETS
from dds_trace.extensions.campaigns.recommend import recommend_settings
from dds_trace.recorder.domains import participants_that_fit

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from dds_trace.analyzer.analysis import Analysis

CLAIMS, CHOICES = STUDY / "claims.csv", STUDY / "choices.csv"


def keep_claims(folder: Path, into: Path = STUDY) -> None:
    """Write the rows of a sweep that the tables are made from."""
    analysis = analyze(folder)
    write_rows(into / CLAIMS.name, run_rows(analysis))
    write_rows(into / CHOICES.name, choice_rows(analysis))


def across(same: str, other: str, **where: tuple[object, ...]) -> Asked:
    """Ask whether a message takes longer across domains than in one."""
    return Asked({"setup": other}, {"setup": same}, where)


def rates(says: str, *fast: float, slow: float = 1.0, **where: tuple[object, ...]) -> list[Asked]:
    """Ask whether higher rates take longer, as long, or another time."""
    return [Asked({"rate_hz": rate}, {"rate_hz": slow}, {"data": ("binary",), **where}, says=says) for rate in fast]


def jump(low: int, high: int, **where: tuple[object, ...]) -> Asked:
    """Ask whether the larger size takes more time than its bytes say, at 1 Hz, which both links carry."""
    where = {"link": (AIR,), "rate_hz": (1.0,), **where}
    return Asked({"payload_bytes": high}, {"payload_bytes": low}, where, factor=SAME * high / low)


def rivals(*slower_and_faster: tuple[str, str]) -> list[Asked]:
    """Ask whether the first of each two setups takes longer."""
    return [Asked({"setup": slower}, {"setup": faster}, {}) for slower, faster in slower_and_faster]


def part(about: str, *asked: Asked, of: str = "each") -> list[Asked]:
    """Return questions as one part of a claim."""
    return [replace(one, about=about, of=of) for one in asked]


LICENCE = "RTI's licence"
WIRED_ACROSS: dict[str, tuple[object, ...]] = {"setup": (CYCLONE_ACROSS,), "link": (WIRED,), "device": (PI,)}
CLAIMS_OF_PAPER: tuple[tuple[str, str, Sequence[Asked]], ...] = (
    (
        "Cyclone DDS across, air: large files slower at higher frequency",
        "",
        rates("more", 4.0, setup=(CYCLONE_ACROSS,), link=(AIR,), payload_bytes=LARGE),
    ),
    (
        "air: a sudden rise at 502 KB",
        "",
        [
            *part("Fast DDS", jump(145_000, 502_000, setup=(FAST, FAST_ACROSS))),
            *part("Cyclone DDS", jump(145_000, 502_000, setup=(CYCLONE, CYCLONE_ACROSS))),
        ],
    ),
    (
        "Fast DDS (later: all) across, air: 502 KB slower than 1 MB",
        "",
        [
            question
            for about, setup in (("Fast DDS", FAST_ACROSS), ("Cyclone DDS", CYCLONE_ACROSS))
            for question in part(
                about,
                Asked({"payload_bytes": LARGE[0]}, {"payload_bytes": LARGE[1]}, {"setup": (setup,), "link": (AIR,)}),
            )
        ],
    ),
    (
        "Cyclone DDS across, wire, Pi 3: consistent over all sizes: no effect of frequency, no jump",
        "",
        [
            *part("frequency", *rates("alike", 4.0, **WIRED_ACROSS, payload_bytes=(*SMALL, *LARGE))),
            *part(
                "no more than the wire's rate demands",
                *(replace(jump(33_000, size, **WIRED_ACROSS), says="less") for size in (145_000, *LARGE)),
            ),
        ],
    ),
    (
        "across, air: a spike above 145 KB",
        "",
        [
            question
            for about, setup in (("Fast DDS", FAST_ACROSS), ("Cyclone DDS", CYCLONE_ACROSS))
            for question in part(about, *(jump(145_000, size, setup=(setup,)) for size in LARGE))
        ],
    ),
    (
        "Cyclone DDS, air, Pi 3: small files faster in one domain, large ones across",
        "",
        [
            *part(
                "small",
                across(CYCLONE, CYCLONE_ACROSS, link=(AIR,), device=(PI,), data=("binary",), payload_bytes=SMALL),
            ),
            *part(
                "large",
                Asked(
                    {"setup": CYCLONE},
                    {"setup": CYCLONE_ACROSS},
                    {"link": (AIR,), "device": (PI,), "payload_bytes": LARGE},
                ),
            ),
        ],
    ),
    (
        "Cyclone DDS, wire, Pi 3: large files faster in one domain",
        "",
        [across(CYCLONE, CYCLONE_ACROSS, link=(WIRED,), device=(PI,), payload_bytes=LARGE)],
    ),
    (
        "Fast DDS: one domain faster for every size, frequency, device, link",
        "`builtin`, not Integration Service",
        part("", across(FAST, FAST_ACROSS), of="every"),
    ),
    ("Connext, air: alike to 87 KB, then across", LICENCE, []),
    ("Connext, wire: alike to 145 KB, then one domain", LICENCE, []),
    (
        "String, IMU: one domain and across alike, Fast DDS across slowest",
        "",
        [
            *part(
                "Cyclone DDS alike",
                Asked({"setup": CYCLONE_ACROSS}, {"setup": CYCLONE}, {"data": ("string", "imu")}, says="alike"),
            ),
            *part(
                "Fast DDS slowest",
                *(
                    Asked({"setup": FAST_ACROSS}, {"setup": other}, {"data": ("string", "imu")})
                    for other in (FAST, CYCLONE, CYCLONE_ACROSS)
                ),
            ),
        ],
    ),
    (
        "frequency mostly matters, not for Fast DDS, Pi 3, air",
        "",
        [
            *part(
                "others differ",
                *rates("differs", 4.0, 20.0, 100.0, setup=(CYCLONE, CYCLONE_ACROSS)),
                *rates("differs", 4.0, 20.0, 100.0, setup=(FAST, FAST_ACROSS), link=(WIRED,)),
                *rates("differs", 4.0, 20.0, 100.0, setup=(FAST, FAST_ACROSS), link=(AIR,), device=(LAPTOP,)),
                of="most",
            ),
            *part(
                "Fast DDS alike",
                *rates("alike", 4.0, 20.0, 100.0, setup=(FAST, FAST_ACROSS), link=(AIR,), device=(PI,)),
            ),
        ],
    ),
    (
        "up to 145 KB no effect of frequency",
        "",
        [
            replace(question, about=about, carried=carried)
            for about, carried in (("what the link carries", True), ("more than it carries", False))
            for question in rates("alike", 4.0, 20.0, 100.0, payload_bytes=SMALL)
        ],
    ),
    ("live camera, Jetson: Connext best across domains", LICENCE, []),
    (
        "across not Fast DDS; Cyclone DDS for large files, air",
        "",
        [
            *part("Fast DDS slower", Asked({"setup": FAST_ACROSS}, {"setup": CYCLONE_ACROSS}, {})),
            *part(
                "large over the air",
                Asked({"setup": FAST_ACROSS}, {"setup": CYCLONE_ACROSS}, {"link": (AIR,), "payload_bytes": LARGE}),
            ),
        ],
    ),
    (
        "no vendor is best everywhere, one domain and across together; mostly one domain wins clearly",
        "",
        [
            *part("Fast DDS faster", *rivals((CYCLONE, FAST), (CYCLONE_ACROSS, FAST_ACROSS)), of="some"),
            *part("Cyclone DDS faster", *rivals((FAST, CYCLONE), (FAST_ACROSS, CYCLONE_ACROSS)), of="some"),
            *part(
                "one domain faster by a quarter",
                *(replace(across(*setups), factor=SAME) for setups in ((FAST, FAST_ACROSS), (CYCLONE, CYCLONE_ACROSS))),
                of="most",
            ),
        ],
    ),
    (
        "more of the large files may arrive across",
        "",
        part(
            "",
            *(
                Asked({"setup": other}, {"setup": same}, {"payload_bytes": LARGE}, value="received")
                for same, other in ((FAST, FAST_ACROSS), (CYCLONE, CYCLONE_ACROSS))
            ),
            of="some",
        ),
    ),
    ("nothing is hard real time across, over the air", "", []),
    ("about 120 participants fit a domain", "", []),
    ("future work", "", []),
)
PARTICIPANTS = 120
FUTURE = (
    (
        "more QoS",
        "`sweep`, axes {}; `record -o deadline`, `-o lifespan`",
        ("reliability", "durability", "history", "depth"),
    ),
    ("stress", "`sweep`, axes {}", ("load", "relays", "pings")),
    ("moving nodes", "`sweep plans/drive.toml`, axes {}", ("outage", "outage_by")),
    ("5G", "`sweep`, link {}", ("5g",)),
    ("security", "`sweep`, axis {}", ("security",)),
    ("a recommender", "`choose`, `advise`", ()),
    ("a GUI that learns", "", ()),
    ("why 502 KB", "`explain size 145KB..1MB plans/paper-explain-size.toml`", ()),
)
"""What it is, and the command with the axes or link that it has."""
EMULATED = {*PRESETS, "outage", "outage_by"}
PAGE = STUDY.with_suffix(".md")


@dataclass(frozen=True, slots=True)
class Need:
    """A need, whom the paper recommends for it, and the job that asks `dds-trace choose`."""

    words: str
    paper: str
    setups: tuple[str, ...]
    job: Mapping[str, str]
    links: tuple[str, ...] = (WIRED, AIR)


TWO = {"domain": "different"}
NEEDS = (
    Need(
        "large files across, air",
        "Cyclone DDS",
        (CYCLONE_ACROSS,),
        {"size": "502KB", "rate": "1", "deadline": "1s", "reliability": "0.8", **TWO},
        (AIR,),
    ),
    Need(
        "small files across",
        "not Fast DDS",
        (CYCLONE_ACROSS,),
        {"size": "33KB", "rate": "20", "deadline": "50ms", "reliability": "0.9", **TWO},
    ),
    Need("both", "Connext", (), {}),
    Need(
        "hard real time across, air",
        "nothing",
        (),
        {"data": "imu", "size": "296", "rate": "100", "deadline": "10ms", "reliability": "0.999", **TWO},
        (AIR,),
    ),
)


def answer_of(runs: Runs, questions: Sequence[Asked]) -> tuple[str, str]:
    """Return what was measured and what it means for the claim, part by part; all of it is emulated."""
    parts: dict[tuple[str, str], list[Pair]] = defaultdict(list)
    for question in questions:
        if pairs := pairs_of(runs, question):
            parts[question.about, question.of] += pairs
    if not parts:
        return "", "not recorded yet"
    labels = {about: f"{about}: " if about else "" for about, _ in parts}
    outcomes = {about: outcome(pairs, of) for (about, of), pairs in parts.items()}
    verdicts = [f"{labels[about]}{verdict}" for about, verdict in outcomes.items()]
    if len(set(outcomes.values())) == 1:
        verdicts = [*set(outcomes.values())]
    words = "; ".join(f"{labels[about]}{measured(pairs)}" for (about, _), pairs in parts.items())
    return words, "; ".join(verdicts)


def late_answer(runs: Runs) -> tuple[str, str]:
    """Return the shares beyond 1, 10 and 100 ms over the air and across domains: the least and the largest of all results."""
    results = {key: own for key, own in runs.items() if key[0] in (FAST_ACROSS, CYCLONE_ACROSS) and key[1] == AIR}
    if not results:
        return "", "not recorded yet"
    least, upper, most = [], [], []
    for ms in LATE_MS:
        sent = {key: sum(int(row["published"]) for row in own) for key, own in results.items()}
        shares = {key: sum(int(row[f"beyond_{ms}_ms"]) for row in own) / sent[key] for key, own in results.items()}
        best = min(shares.values())
        # None late of n messages: up to 3 of n may be, whatever the runs' levels say.
        uppers = [
            max(float(results[key][0][f"upper_{ms}_ms"] or 1), 3 / sent[key])
            for key, share in shares.items()
            if share == best
        ]
        least, upper, most = [*least, best], [*upper, min(uppers)], [*most, max(shares.values())]
    words = [", ".join(f"{100 * share:.3g}" for share in shares) for shares in (least, upper, most)]
    never = ", ".join(str(ms) for ms, share in zip(LATE_MS, least, strict=True) if share)
    undecided = ", ".join(str(ms) for ms, share in zip(LATE_MS, least, strict=True) if not share)
    verdicts = [f"reproduced at {never} ms"] * bool(never) + [f"not decidable at {undecided} ms"] * bool(undecided)
    shown = "beyond 1, 10, 100 ms in the best result {} % (further runs: up to {} %), in the worst {} %"
    return shown.format(*words), "; ".join(verdicts)


def participants_answer(_runs: Runs) -> tuple[str, str]:
    """Return how many participants the ports of a domain are for, all domains: the least and the most."""
    counts = [participants_that_fit(domain) for domain in range(DOMAIN_ID.high + 1)]
    least, usual = min(counts), median(counts)
    words = f"by the ports of DDSI-RTPS {usual:g}, in the last domain {least}; `dds-trace record relay --domain {DOMAIN_ID.high}` warns"
    return words, "as calculated" if usual == PARTICIPANTS else CONTRADICTED


def causes_found() -> list[str | None]:
    """Return what moves the jump in each setup, None where it is not known, as the block of `explain size` on the page has it."""
    causes = re.findall(r"what moves it: (.+)", PAGE.read_text())
    return [None if cause == "not known" else cause for cause in causes]


def state_of(how: str, names: Sequence[str]) -> str:
    """Return how far a work is done: by its command, and for a question by the answers that its traces give."""
    if "`explain" in how:
        found = [cause is not None for cause in causes_found()]
        return "done" if found and all(found) else "in part" if any(found) else "not done"
    return "emulated" if EMULATED & {*names} else "done" if how else "not done"


def future_answer(_runs: Runs) -> tuple[str, str]:
    """Return what is done of each future work, with its command; a named axis or link that is not there is an error."""
    missing = [name for _, _, names in FUTURE for name in names if name not in {**AXES, **PRESETS}]
    if missing:
        raise KeyError(*missing)
    causes = Counter(cause or "not known" for cause in causes_found())
    answers = ", ".join(f"{cause} {count} of {causes.total()}" for cause, count in causes.items())
    commands = [
        f"{what}: {how.format(', '.join(f'`{name}`' for name in names))}" + f" ({answers})" * ("`explain" in how)
        for what, how, names in FUTURE
        if how
    ]
    done: dict[str, list[str]] = defaultdict(list)
    for what, how, names in FUTURE:
        done[state_of(how, names)].append(what)
    return "; ".join(commands), "; ".join(f"{state}: {', '.join(work)}" for state, work in done.items())


WITHOUT_PAIRS = {18: late_answer, 19: participants_answer, 20: future_answer}


def claim_table(rows: Sequence[Row]) -> str:
    """Return the twenty claims of the paper, with what the rows of `keep_claims` say of each."""
    runs = runs_of(rows)
    lines = []
    for number, (claim, remark, questions) in enumerate(CLAIMS_OF_PAPER, 1):
        words, verdict = "", "not possible here"
        if questions:
            words, verdict = answer_of(runs, questions)
        elif number in WITHOUT_PAIRS:
            words, verdict = WITHOUT_PAIRS[number](runs)
        lines.append([str(number), claim, "; ".join(filter(None, (words, remark))), verdict])
    return markdown(["#", "the paper says", "so in", "outcome (1 to 18 emulated)"], lines)


def choice_rows(analysis: Analysis) -> list[dict[str, object]]:
    """Return a row for each candidate of each need, as `dds-trace choose` ranks them; times are of the response, T0 to T2."""
    messages, rows = analysis.load_messages(), []
    for need in NEEDS:
        if need.job:
            job = make_job(**need.job)
            for candidate in recommend_settings(messages, job, runs=analysis.runs).candidates:
                place = place_of(candidate.setting)
                if place["link"] in need.links:
                    is_best = candidate.fit is Fit.MEETS and candidate.tied
                    fit = {"need": need.words, **place, "fit": candidate.fit.value, "is_best": is_best}
                    rows.append({**fit, "response_ns": candidate.value_ns})
    return rows


SAME_AS_PAPER, OTHER, OPEN = "same", "other", "not decidable"


def best_words(candidates: Sequence[Row]) -> str:
    """Return who meets a job best, or that nothing does."""
    best = [WORDS[row["setup"]] for row in candidates if row["is_best"] == "True"]
    likely = [WORDS[row["setup"]] for row in candidates if row["fit"] == Fit.LIKELY.value]
    return (
        " or ".join(best)
        or " or ".join(f"likely {name}" for name in likely)
        or ("nothing" if {row["fit"] for row in candidates} == {"misses"} else "undecided")
    )


def compared(need: Need, candidates: Sequence[Row]) -> str:
    """Return whether ours is the paper's choice at one place."""
    best, fits = {row["setup"] for row in candidates if row["is_best"] == "True"}, {row["fit"] for row in candidates}
    if best:
        return SAME_AS_PAPER if best <= {*need.setups} else OPEN if best & {*need.setups} else OTHER
    if fits == {"misses"}:
        return OTHER if need.setups else SAME_AS_PAPER
    return OPEN


def need_table(rows: Sequence[Row]) -> str:
    """Return for each need whom the paper recommends, and what `dds-trace choose` says of the rows of a sweep."""
    lines = []
    for need in NEEDS:
        places: dict[tuple[str, str], list[Row]] = defaultdict(list)
        for row in rows:
            if row["need"] == need.words:
                places[row["link"], row["device"]].append(row)
        shown = {place_words(place): best_words(candidates) for place, candidates in sorted(places.items())}
        words = [f"{place}: {best}" for place, best in shown.items()]
        if len(set(shown.values())) == 1 < len(shown):
            words = [f"{next(iter(shown.values()))} at {len(shown)} places"]
        counts = Counter(compared(need, candidates) for candidates in places.values())
        verdict = ", ".join(f"{what} at {count} of {len(places)}" for what, count in counts.most_common())
        verdict = verdict if len(counts) > 1 else next(iter(counts), OPEN)
        options = " ".join(f"--{name}={value}" for name, value in need.job.items())
        lines.append([need.words, f"`{options}`" if options else LICENCE, need.paper, "; ".join(words), verdict])
    return markdown(["need", "`dds-trace choose runs/paper-claims`", "the paper", "here", "the same?"], lines)

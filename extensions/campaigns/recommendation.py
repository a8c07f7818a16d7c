"""The recommendation in words."""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import polars as pl

from dds_trace.analyzer.model.parameters import QOS_DEFAULTS, SETTING_COLUMNS, SITE_COLUMNS
from dds_trace.analyzer.model.setting import choice_of, parse_setting
from dds_trace.analyzer.statistics.intervals import MIN_RUNS
from dds_trace.analyzer.statistics.percentiles import planned_messages
from dds_trace.analyzer.verdicts.cases import Setting
from dds_trace.analyzer.verdicts.job import Job
from dds_trace.analyzer.verdicts.recommend import LONG_BURST, Candidate, Fit, Recommendation, place_of
from dds_trace.base.printable import printable
from dds_trace.base.units import MISSING, counted, format_duration, format_ratio, joined, spell_duration, spell_size
from dds_trace.reports.blocks import MARKS, OPEN, Block, Command, Points, Sentence, Span
from dds_trace.reports.book.groups import LOST, METRIC_LABELS, Cell, VendorLabels, setting_labels, times_words
from dds_trace.reports.book.verdicts import few_words, place_label


@dataclass(frozen=True, slots=True)
class Advice:
    """`rows` are setting, whether it meets the deadline, and its numbers with what they rest on."""

    job: str
    sentence: str
    rows: tuple[tuple[str, str, str], ...]
    missing: str = ""
    commands: tuple[tuple[str, str], ...] = ()

    def blocks(self, most: int | None = None) -> Iterator[Block]:
        yield Sentence(self.sentence, "headline")
        yield Sentence(f"Job: {self.job} Ranked by these recordings; `advise` goes by fresh runs of its own.", "soft")
        items = [
            [MARKS.get(fit, OPEN), Span(" ", ""), Span(f"{setting}: {fit}"), Span(f"; {numbers}", "soft")]
            for setting, fit, numbers in self.rows[:most]
        ]
        yield Points(items, bullet="1.")
        if most and len(self.rows) > most:
            yield Sentence(f"and {counted(len(self.rows) - most, 'more setup')}: --all", "soft")
        if self.missing:
            yield Sentence(self.missing)
        yield from (Command(*command) for command in self.commands)


def recommendation_info(
    recommendation: Recommendation, vendors: VendorLabels, summary: pl.DataFrame | None = None
) -> Advice:
    candidates = recommendation.candidates
    site = dict.fromkeys(SITE_COLUMNS, "")
    choices = [{**one.setting, **site, "setting": choice_of(str(one.setting["setting"]))} for one in candidates]
    names = setting_labels(choices, vendors)
    pairs = [_pair(candidate) for candidate in candidates]
    several = len(set(pairs)) > 1
    full_names = [f"{name}, on {pair}" if several else name for name, pair in zip(names, pairs, strict=True)]
    by_pair: dict[str, list[tuple[Candidate, str]]] = {}
    for candidate, name, pair in zip(candidates, names, pairs, strict=True):
        by_pair.setdefault(pair, []).append((candidate, name))
    deadline = f"the deadline of {format_duration(recommendation.job.deadline_ns)}"
    sentences = [
        f"{f'On {pair}: ' if several else ''}{_sentence(candidates_there, deadline, opens=not several)}"
        for pair, candidates_there in by_pair.items()
    ]
    for runs, ratio in sorted((c.runs, c.unseen_ratio) for c in recommendation.best if c.unseen_ratio is not None)[:1]:
        sentences.append(
            f"With {counted(runs, 'run')}, a kind of run that comes once in ten is missed in {100 * ratio:.2g} %."
        )
    missed = max((one.missed_ratio(recommendation.job.reliability) for one in recommendation.best), default=0.0)
    if missed >= _WORTH_A_SENTENCE:
        sentences.append(
            f"None of its messages was late; if twice as many as allowed are lost, in bursts of {LONG_BURST}, none is in {100 * missed:.2g} %."
        )
    sentences += [] if summary is None else _own_nodes(recommendation, names, summary)
    reason = candidates[0].reason if candidates else ""
    if reason and len(candidates) > 1 and {(row.fit, row.reason) for row in candidates} == {(Fit.MISSES, reason)}:
        sentences.append(f"Of each: {reason}.")
        candidates = tuple(replace(row, reason="") for row in candidates)
    missing, commands = _missing(recommendation, full_names)
    return Advice(
        job=_job_words(recommendation.job),
        sentence=" ".join(sentences) or _NOTHING,
        rows=tuple(_row(candidate, name) for candidate, name in zip(candidates, full_names, strict=True)),
        missing=missing,
        commands=commands,
    )


_WORTH_A_SENTENCE = 0.05


def _own_nodes(recommendation: Recommendation, names: Sequence[str], summary: pl.DataFrame) -> Iterator[str]:
    job = recommendation.job
    matching = summary.filter(data_type=job.data_type, payload_bytes=job.payload_bytes, rate_hz=job.rate_hz)
    own_ns = {
        tuple(row[name] for name in SETTING_COLUMNS): row["own_cost_ns"] for row in matching.iter_rows(named=True)
    }
    leaders: dict[object, tuple[float, float, str]] = {}
    for candidate, name in zip(recommendation.candidates, names, strict=True):
        value_ns, cost_ns = candidate.value_ns, own_ns.get(tuple(candidate.setting[name] for name in SETTING_COLUMNS))
        if value_ns is None or cost_ns is None or math.isinf(value_ns):
            continue
        cost_ns /= 1 if job.metric == "response" else 2  # it is of a round trip
        lead_ns, lead_cost_ns, leader = leaders.setdefault(place_of(candidate.setting), (value_ns, cost_ns, name))
        if 0 < value_ns - lead_ns < cost_ns - lead_cost_ns:
            yield (
                f"{name} comes {format_duration(value_ns - lead_ns)} after {leader}, and our own nodes cost "
                f"{format_duration(cost_ns - lead_cost_ns)} more on it: it may be our Python, not the middleware."
            )


def _messages_of_run(candidate: Candidate, reliability: float) -> tuple[int, int]:
    runs = max(MIN_RUNS, candidate.needed_runs or candidate.runs)
    needed = max(planned_messages(reliability), candidate.needed or 0)
    if candidate.messages < needed or candidate.runs < MIN_RUNS:
        return runs, math.ceil(needed / runs)
    enough = candidate.messages / candidate.runs if candidate.needed_runs else 2 * candidate.messages / runs
    return runs, math.ceil(max(needed / runs, enough))


def _missing(recommendation: Recommendation, names: Sequence[str]) -> tuple[str, tuple[tuple[str, str], ...]]:
    decided = (Fit.MEETS, Fit.MISSES)
    unclear = [
        (one, name) for one, name in zip(recommendation.candidates, names, strict=True) if one.fit not in decided
    ]
    if not unclear:
        return "", ()
    first, name = unclear[0]
    runs, messages = _messages_of_run(first, recommendation.job.reliability)
    commands = recording_commands(first.setting, recommendation.job, messages, runs)
    how = (
        "; its trace does not have all of its plan: sweep that again.",
        ", by a sweep:",
        ", each into a file of its own:",
    )
    return f"To decide {name}, record about {runs} runs of {messages:,} messages of it{how[len(commands)]}", commands


def _pair(candidate: Candidate) -> str:
    ping_device, relay_device, connectivity, conditions = place_of(candidate.setting)
    relay = None if relay_device is None else str(relay_device)
    return place_label(str(ping_device), relay, str(connectivity), str(conditions))


_NOTHING = "The traces have no messages of this kind."

_JUDGED_BY = {"response": "from planned send to reply", "latency": "by the latency, the mean of both ways"}


def _job_words(job: Job) -> str:
    metric = METRIC_LABELS.get(job.metric, printable(job.metric)).lower()
    words = (
        f"{Cell(job.data_type, job.payload_bytes, job.rate_hz).label}: "
        f"{format_ratio(job.reliability)} of the messages within the deadline of {format_duration(job.deadline_ns)}, "
        f"{_JUDGED_BY.get(job.metric, f'by the {metric}')}"
    )
    if job.domain_mode is not None:
        words += f"; {printable(job.domain_mode)} domain" + ("s" if job.domain_mode == "different" else "")
    return f"{words}."


def _sentence(candidates: Sequence[tuple[Candidate, str]], deadline: str, *, opens: bool) -> str:
    best = [name for candidate, name in candidates if candidate.fit is Fit.MEETS and candidate.tied]
    if best:
        verb = "meets" if len(best) == 1 else "meet"
        tied = "" if len(best) == 1 else ", and their intervals overlap"
        return f"{joined(best, comma='; ')} {verb} {deadline}{tied}."
    likely = [name for candidate, name in candidates if candidate.fit is Fit.LIKELY]
    if likely:
        words = f"no setup is proven to meet {deadline}; likely to meet it: {joined(likely, comma='; ')}."
    elif all(candidate.fit is Fit.MISSES for candidate, _ in candidates):
        is_measured = any(candidate.measured for candidate, _ in candidates)
        words = f"{'every setting that was measured misses' if is_measured else 'no setup can meet'} {deadline}."
    else:
        words = f"no setup is proven to meet {deadline}; some may."
    return words[0].upper() + words[1:] if opens else words


def _row(candidate: Candidate, name: str) -> tuple[str, str, str]:
    time, *ends = times_words([candidate.value_ns, candidate.lower_ns, candidate.upper_ns])
    share, numbers, basis = format_ratio(candidate.received_ratio), list[str](), list[str]()
    if candidate.value_ns is not None:
        kind = "95 %: " if candidate.measured else "90 %: "
        interval = f"{time} ({kind}{' to '.join(ends)})"
        numbers.append(time if MISSING in ends or {*ends} == {time} else interval)
        basis = ["a guess"]
    if share != MISSING:
        is_lost = time == LOST and candidate.survivors_ns is not None
        numbers.append(
            f"received {share}" + (f" (those in {times_words([candidate.survivors_ns])[0]})" if is_lost else "")
        )
    if candidate.measured:
        basis = [counted(candidate.runs, "run")]
        basis += [few_words(candidate.runs)] if candidate.basis == "within one run" else []
        basis += [] if candidate.episodes is None else [counted(candidate.episodes, "burst")]
    parts = (", ".join(numbers), ", ".join(basis), candidate.reason)
    fit = "unclear" if candidate.fit is Fit.INCONCLUSIVE else candidate.fit.value
    return name, fit, "; ".join(filter(None, parts))


_SHOWN = ("rmw", "discovery", "tuned", "wire")
_KEYS = {"realtime_priority": "realtime", "response_bytes": "response_size"}


def _option_of(field: str) -> str:
    key = _KEYS.get(field) or re.sub("_(ns|ms|bytes)$", "", field)
    return f"--{key}" if field in _SHOWN else f"-o {key}"


_SIDE_FIELDS = """durability history serialization cpu_affinity load priority when_full security realtime_priority wire discovery
    transport executor tuned congestion_control deadline_ns lifespan_ns rmw multicast buffer_bytes segment_bytes fragment_bytes call
    response_bytes"""
SETTING_OPTIONS = {field: _option_of(field) for field in _SIDE_FIELDS.split()}
"""Setting of one side -> its option; any other is a `setting` of the ping."""

PING_OPTIONS = {
    field: _option_of(field)
    for field in ("bridge_running", "bridge_listen", "relays", "nodes", "ping_share", "wake_ms", "clients")
}

LISTENS_AT = "0.0.0.0:7447"
"""A trace does not contain the address of a bridge's half."""

IMU = "imu"
"""Its messages have one size."""

_HASH = re.compile(r"#[0-9a-f]+")


_NOT_IN_TRACE = frozenset({"environment", "configuration", "flow", "with", "flows"})
"""Settings by files or other messages."""

_MADE_BY_SWEEP = frozenset({"link", "queue", "outage", "outage_by", "pings", "hosts", "topics", "relays"})
"""Settings that `record` only names."""

_NOT_OF_AN_AXIS = frozenset(
    {"cpu_affinity", "deadline_ns", "lifespan_ns", "discovery", "bridge_running", "bridge_listen"}
)


def recording_commands(setting: Setting, job: Job, messages: int, runs: int) -> tuple[tuple[str, str], ...]:
    """Return device and command: of both sides, of a sweep, or none."""
    extra = parse_setting(str(setting["setting"]))
    is_here, connectivity = setting["ping_device"] == setting["relay_device"], str(setting["connectivity"])
    is_swept = bool(_MADE_BY_SWEEP & extra.keys()) or (is_here and connectivity != "loopback")
    is_named_only = connectivity.startswith("emulated-") and "link" not in extra
    if _NOT_IN_TRACE & extra.keys() or is_named_only or (is_swept and not is_here):
        return ()
    relay_extra = {key.removeprefix("relay."): extra.pop(key) for key in list(extra) if key.startswith("relay.")}
    variables = {key: extra.pop(key) for key in list(extra) if key.isupper()}
    if is_swept:
        length = {"messages": messages} if job.rate_hz else {"seconds": _SECONDS_AT_MAX}
        plan = _plan(setting, extra, relay_extra, job, {**length, "repeats": runs})
        lines = [shlex.quote(printable(f"{key}={_toml(value)}")) for key, value in plan]
        write = " ".join(["printf '%s\\n'", *lines, "> decide.toml"])
        sweep = " ".join([*_assigned(variables), "dds-trace sweep decide.toml"])
        return ((printable(str(setting["ping_device"])), f"{write} && {sweep}"),)
    qos = {name: str(setting[name]) for name in QOS_DEFAULTS}
    own = {key: value for key, value in extra.items() if key in SETTING_OPTIONS}
    ping = {"rmw": str(setting["rmw"]), **own, **qos} if setting["rmw"] else {**own, **qos}
    has_same_backend = setting["relay_backend"] in (None, setting["backend"])
    relay = {**(ping if has_same_backend else {**own, **qos}), **relay_extra}
    if setting["connectivity"] == "loopback":
        ping, relay = ({"discovery": "localhost", **side} for side in (ping, relay))
    sides = (
        ("relay", setting["relay_backend"] or setting["backend"], setting["relay_device"], relay, ()),
        ("ping", setting["backend"], setting["ping_device"], ping, _message(setting, extra, job, messages)),
    )
    relay_words, ping_words = (
        (
            printable(str(device or "the relay's device")),
            _spelled(variables, role, ["--backend", str(backend), *options, *_side(values, setting, device)]),
        )
        for role, backend, device, values, options in sides
    )
    return relay_words, ping_words


def _message(setting: Setting, extra: Mapping[str, str], job: Job, messages: int) -> Iterator[str]:
    if setting["bridge"] != "none":
        yield from ("--bridge", str(setting["bridge"]))
    yield from ("--data", extra.get("data", job.data_type))
    if "data" not in extra and job.data_type != IMU:
        yield from ("--size", spell_size(job.payload_bytes))
    yield from ("--rate", f"{job.rate_hz:g}" if job.rate_hz else "max", "--messages", str(messages))
    for key, value in sorted(extra.items()):
        if key in PING_OPTIONS:
            yield from _option(PING_OPTIONS[key], LISTENS_AT if key == "bridge_listen" else value)
        elif key not in SETTING_OPTIONS and key not in ("data", "flows"):
            yield from ("-o", f"setting={key}={value}")


def _side(values: Mapping[str, str], setting: Setting, device: object) -> Iterator[str]:
    for key, value in sorted(values.items()):
        if value not in (str(QOS_DEFAULTS.get(key)), "default"):
            text = spell_duration(int(value)) if key.endswith("_ns") and value.isdecimal() else value
            yield from _option(SETTING_OPTIONS.get(key, f"--{key}"), text)
            yield from ("-o", "keys=keys") if key == "security" else ()
    if setting["connectivity"] != "loopback":
        yield from ("-o", f"connectivity={setting['connectivity']}")
    if device is not None:
        yield from ("-o", f"device={device}")


def _option(name: str, value: str) -> tuple[str, ...]:
    if name.startswith("-o "):
        return "-o", f"{name[3:]}={value}"
    return (name,) if value in ("true", "false") else (name, value)


def _spelled(variables: Mapping[str, str], role: str, arguments: list[str]) -> str:
    words = ["dds-trace", "record", role, *arguments, "--out", f"runs/{role}.mcap"]
    return " ".join([*_assigned(variables), *(shlex.quote(printable(word)) for word in words)])


def _assigned(variables: Mapping[str, str]) -> list[str]:
    return [f"{key}={shlex.quote(printable(_HASH.sub('', value)))}" for key, value in sorted(variables.items())]


def _plan(
    setting: Setting, extra: Mapping[str, str], relay_extra: Mapping[str, str], job: Job, run: Mapping[str, object]
) -> Iterator[tuple[str, object]]:
    options = {**SETTING_OPTIONS, **PING_OPTIONS}
    yield from ((f"run.{key}", value) for key, value in run.items())
    link, _, inner = extra.get("link", "").rstrip(")").partition("(")
    pairs = [pair.partition("=")[::2] for pair in inner.split(",") if pair]
    yield from (("link.name", link), *((f"link.{key}", _link_value(key, text)) for key, text in pairs)) if link else ()
    yield from () if link or setting["connectivity"] == "loopback" else (("network.namespaces", True),)
    sides = {name: setting[name] for name in ("backend", "rmw", "bridge", *QOS_DEFAULTS)}
    sides |= {"relay_backend": setting["relay_backend"], "relay_rmw": relay_extra.get("rmw")}
    usual = {**QOS_DEFAULTS, "bridge": "none", "relay_backend": setting["backend"]}
    yield from ((f"axes.{name}", value) for name, value in sides.items() if value not in (None, usual.get(name)))
    further: dict[str, list[str]] = {"ping": [], "relay": []}
    for key, text in extra.items():
        name = options.get(key, key).removeprefix("--").removeprefix("-o ")
        if key in _NOT_OF_AN_AXIS:
            value = spell_duration(int(text)) if key.endswith("_ns") and text.isdecimal() else text
            for side in further if key in SETTING_OPTIONS else ("ping",):
                further[side] += _option(options[key], value)
        elif key in options or key in _MADE_BY_SWEEP - {"link"}:
            yield f"{'run' if key == 'wire' else 'axes'}.{name}", _typed(_UNIT_OF_TIME.sub("", text))
        elif key not in ("link", "data"):
            further["ping"] += ["--setting", f"{key}={text}"]
    for key, text in relay_extra.items():
        further["relay"] += () if key == "rmw" or text == "default" else _option(options.get(key, f"--{key}"), text)
    yield from ((f"devices.{side}.options", words) for side, words in further.items() if words)
    sent = {"data": extra.get("data", job.data_type), "rate": f"{job.rate_hz:g}" if job.rate_hz else "max"}
    has_size = "data" not in extra and job.data_type != IMU
    yield (
        "matrix",
        [{**sent, "rate": _typed(sent["rate"]), **({"size": spell_size(job.payload_bytes)} if has_size else {})}],
    )


_SECONDS_AT_MAX = 10
_UNIT_OF_TIME = re.compile(r"(?<=\d)m?s$")


def _link_value(key: str, text: str) -> object:
    return text == "1" if key == "shared" else _HASH.sub("", text) if key == "file" else _typed(text)


def _typed(text: str) -> object:
    if text in ("true", "false"):
        return text == "true"
    try:
        return int(text) if text.isdecimal() else float(text)
    except ValueError:
        return text


def _toml(value: object) -> str:
    if isinstance(value, Mapping):
        return f"{{{','.join(f'{key}={_toml(item)}' for key, item in value.items())}}}"
    if isinstance(value, list):
        return f"[{','.join(map(_toml, value))}]"
    return json.dumps(value, ensure_ascii=False)

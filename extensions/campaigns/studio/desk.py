"""What the page of `dds-trace studio` asks and sees; the search runs in the thread that calls `Desk.work`."""

from __future__ import annotations

import json
import math
import queue
import shlex
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import Any, NoReturn

from dds_trace.base import limits
from dds_trace.base.errors import UNREADABLE, OptionError, TraceError
from dds_trace.base.files import asset, open_regular
from dds_trace.base.records import to_json
from dds_trace.base.streams import say
from dds_trace.cli.doctor import middleware_checks
from dds_trace.extensions.live.local_server import Answer

from ..answer import answer
from ..halving import Event
from ..plan.link import PRESETS
from ..question import Question, ask, limits_of

FIELDS = ("data", "size", "rate", "deadline", "in_time", "minutes", "host", "link")
"""Names of the form, and of the options of `dds-trace advise`."""

MOST_EARLIER, MOST_ANSWER_BYTES = 20, 1 << 20
"""Earlier answers that are shown, the newest ones, and the largest file of one."""

LOOK_S = 1.0
"""Longest wait at a time: a signal just before it, or to another thread, does not end it."""

_PAGE, _HTML = __name__.rpartition(".")[0], "text/html"
_REPORT = "dds_trace.reports.html"


class _StoppedError(Exception):
    """The page's button was pressed."""


@dataclass(slots=True)
class Row:
    """A candidate as the page shows it: its last event, and in `course` the median of each of its runs so far, in ms."""

    event: Event
    course: list[float | None] = field(default_factory=list)

    def take(self, event: Event) -> None:
        self.event = event
        if event.state == "measured":
            self.course.append(event.p50_ms)

    @property
    def rank(self) -> tuple[bool, bool, float, float]:
        """The leaders first: what the proof is of, what arrives in time, what is fast."""
        event = self.event
        slow = math.inf if event.p50_ms is None or event.p99_ms is None else event.p50_ms * event.p99_ms
        late = max(event.lost, event.late) / max(1, event.messages)
        return event.state == "dropped", event.stage == "look", late, slow

    def to_dict(self) -> dict[str, Any]:
        """Return the event with `name`, `course`, and a `text` that does not repeat the name."""
        row = self.event.to_dict()
        name = row.pop("candidate")["name"]
        text = row["text"].removeprefix(f"{name} gets no more runs: ")
        return {**row, "name": name, "text": text, "course": self.course}


class Desk:
    """One question at a time, its progress, and the answers in a folder; `search` is as `answer`."""

    def __init__(self, out: Path, search: Callable[..., dict[str, Any]] = answer) -> None:
        self._out, self._search = out, search
        self._questions: queue.Queue[Question] = queue.Queue(1)
        self._lock, self._is_stopped = threading.Lock(), False
        self._rows: dict[str, Row] = {}
        self._shown: dict[str, Any] = {"running": False, "note": "", "error": "", "answer": None}
        self._earlier = self._read_earlier()
        text = partial(asset, _PAGE)
        self.answers: Mapping[str, Callable[[], Answer]] = {
            "/": lambda: (_HTML, text("studio.html").encode(), ""),
            "/studio.css": lambda: ("text/css", (asset(_REPORT, "page.css") + text("studio.css")).encode(), ""),
            "/studio.js": lambda: ("text/javascript", (asset(_REPORT, "theme.js") + text("studio.js")).encode(), ""),
            "/machine": cache(lambda: _json({"middlewares": list(middleware_checks()), "links": list(PRESETS)})),
            "/state": self._state,
            "/settings": self._settings,
        }
        self.posts: Mapping[str, Callable[[bytes], Answer]] = {"/ask": self._ask, "/stop": self._stop}

    def work(self) -> NoReturn:
        """Answer questions until the process is interrupted."""
        while True:
            try:
                question = self._questions.get(timeout=LOOK_S)
            except queue.Empty:
                continue
            try:
                result = self._search(question, self._out, self._tell)
                self._show(running=False, note="", answer=result)
                say(result["sentence"])
            except _StoppedError:
                self._show(
                    running=False, note="Stopped; what was measured is kept, and the same question goes on from it."
                )
            except (TraceError, OSError) as err:
                self._show(running=False, note="", error=str(err))
            self._earlier = self._read_earlier()

    def _tell(self, event: Event) -> None:
        with self._lock:
            if event.candidate is not None and event.state and event.stage != "fit":  # of other sizes and rates
                self._rows.setdefault(event.candidate.name, Row(event)).take(event)
            self._shown |= {"left_s": event.left_s, "stage": event.stage, "note": event.text or self._shown["note"]}
        if self._is_stopped and event.stage != "answer":  # which is written
            raise _StoppedError

    def _show(self, **values: object) -> None:
        with self._lock:
            self._shown |= values

    def _ask(self, body: bytes) -> Answer:
        try:
            form = _form_of(body)
            question = question_of(form)
        except OptionError as err:
            return _json({"error": str(err)})
        with self._lock:
            if self._shown["running"]:
                return _json({"error": "a search is under way; it is shown here"})
            self._rows, self._is_stopped = {}, False
            self._shown = {
                "running": True,
                "question": form,
                "command": command_of(form),
                "deadline_ms": question.limits.deadline_ms,
                "left_s": 60 * question.minutes,
                "note": "starting",
                "error": "",
                "answer": None,
            }
            self._questions.put_nowait(question)
        return _json({"error": ""})

    def _stop(self, _body: bytes) -> Answer:
        with self._lock:
            if self._shown["running"]:
                self._is_stopped = True
                self._shown["note"] = "stopping after this run"
        return _json({"error": ""})

    def _state(self) -> Answer:
        with self._lock:
            rows = sorted(self._rows.values(), key=lambda row: row.rank)
            return _json({**self._shown, "rows": [row.to_dict() for row in rows], "earlier": self._earlier})

    def _settings(self) -> Answer:
        """Return the file of settings of this session's answer, which the search has named, or its lines for a shell."""
        with self._lock:
            recommended = (self._shown["answer"] or {}).get("recommended") or {}
        lines, path = recommended.get("exports", []), recommended.get("configuration")
        text = "".join(f"{line}\n" for line in lines).encode()
        return "text/plain", text if path is None else Path(path).read_bytes(), ""

    def _read_earlier(self) -> list[dict[str, object]]:
        """Return the newest answers of the folder; what is none is left out."""
        earlier = list[tuple[float, dict[str, object]]]()
        for path in self._out.glob("*/answer.json"):
            with suppress(*UNREADABLE, IndexError), open_regular(path, follow_links=False) as file:
                stored = json.loads(file.read(MOST_ANSWER_BYTES))
                earlier.append((path.stat().st_mtime, _earlier(path.parent.name, stored)))
        return [answer for _, answer in sorted(earlier, key=lambda row: row[0], reverse=True)][:MOST_EARLIER]


def _earlier(name: str, stored: Mapping[str, Any]) -> dict[str, object]:
    """Return an answer of the folder with the form that asks it again; what is no answer raises one of `UNREADABLE`."""
    question, link = stored["question"], stored["link"] or {}
    message, deadline_ms = question["messages"][0], question["limits"]["deadline_ms"]
    form = {
        "data": str(message["data"]),
        "size": f"{int(message['size'])}B" if message["size"] else "",
        "rate": f"{float(message['rate_hz']):g}",
        "deadline": "" if deadline_ms is None else f"{float(deadline_ms):g}ms",
        "minutes": f"{float(question['minutes']):g}",
        "host": str(question["host"] or ""),
        "link": link["name"] if link.get("name") in PRESETS else "",
    }
    return {"name": name, "sentence": str(stored["sentence"]), "form": form}


def question_of(form: Mapping[str, str]) -> Question:
    """Return the question of a form; an `OptionError` names a wrong value."""
    if not form["rate"]:
        raise OptionError("--rate: give the messages a second, such as 20")
    if "/" in form["host"] or form["host"].endswith(".toml") or form["link"] not in ("", *PRESETS):
        raise OptionError("--host and --link: the page takes names; files are for dds-trace advise")
    try:
        minutes = float(form["minutes"] or 10)
    except ValueError:
        minutes = math.nan
    limits.check(limits.SEARCH_MINUTES, minutes, "--minutes")
    hosts = [form["host"]] if form["host"] else []
    plan = ask(
        form["size"] or None, form["rate"], data=form["data"] or "binary", link=form["link"] or None, hosts=hosts
    )
    return Question(plan, limits_of(form["deadline"] or None, form["in_time"] or "99%"), minutes)


def command_of(form: Mapping[str, str]) -> str:
    """Return the command line that asks the same."""
    words = [f"--{name.replace('_', '-')} {shlex.quote(form[name])}" for name in FIELDS if form[name]]
    return " ".join(["dds-trace advise", *words])


def _form_of(body: bytes) -> dict[str, str]:
    try:
        values = json.loads(body)
        form = {name: values.get(name, "") for name in FIELDS}
    except UNREADABLE:
        form = {}
    if not form or not all(isinstance(value, str) for value in form.values()):
        raise OptionError("this is no form of the page")
    return {name: value.strip() for name, value in form.items()}


def _json(value: object) -> Answer:
    body = json.dumps(to_json(value, not_finite=lambda _: None)).encode()
    return "application/json", body, sha256(body).hexdigest()[:16]

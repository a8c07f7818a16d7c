"""Fuzz target `descriptions`: sessions, runs and samples of hosts and wires give an analysis and its reports, or a `TraceError`."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

from fuzz_shapes import changed_fields, must_name, shaped, shaped_seeds
from trace_files import Message, ping_events, ping_session, relay_events, relay_session, run, write_trace
from wording import report_as

from dds_trace.analyzer.pipeline import analyze
from dds_trace.base.errors import TraceError
from dds_trace.reports.reporters import REPORT_MODULES
from dds_trace.tracefile.format.descriptions import Run, Session

MESSAGES = [
    Message(n, t0=1000 * n, t1=1000 * n + 5, t3=1000 * n + 9, t4=1000 * n + 12, t2=1000 * n + 30) for n in range(12)
]
HOST = {
    "cpu_percent": [3.0, 4.5],
    "processes": {"ping": {"cpu_percent": 1.0, "rss_bytes": 1000}},
    "link": {"ping": {"sent_bytes": 3}},
    "stolen_ns": 5,
}


@dataclass(frozen=True)
class Text:
    """A description whose text is as it is, whatever it says; `write_trace` asks it as it asks a `Session` or a `Run`."""

    text: str
    wall_anchor_ns: int = 0

    def to_json(self) -> str:
        return self.text

    def wall_ns(self, monotonic_ns: int) -> int:
        return max(monotonic_ns, 0)


class Target:
    """Texts that are parsed alone, and good ones with hostile values that are analyzed and reported."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._shapes = (self._session_text, self._run_text, self._analyzed)

    def try_input(self, data: bytes) -> None:
        shaped(self._shapes, data)

    def seeds(self) -> dict[str, bytes]:
        return shaped_seeds(
            self._shapes,
            {
                self._session_text: ping_session().to_json().encode(),
                self._run_text: run().to_json().encode(),
                self._analyzed: bytes(3),
            },
        )

    def _session_text(self, data: bytes) -> None:
        _parse(Session, data.decode(errors="replace"))

    def _run_text(self, data: bytes) -> None:
        _parse(Run, data.decode(errors="replace"))

    def _analyzed(self, data: bytes) -> None:
        """The bytes are changes to the descriptions of a ping and a relay, whose traces are then analyzed."""
        good = {
            "ping": json.loads(ping_session().to_json()),
            "relay": json.loads(relay_session().to_json()),
            "run": json.loads(run(planned_messages=len(MESSAGES), published=len(MESSAGES)).to_json()),
            "host": [HOST],
        }
        hostile = changed_fields(good, data)
        runs = self._folder / "runs"
        shutil.rmtree(runs, ignore_errors=True)
        texts = {name: Text(json.dumps(hostile.get(name))) for name in ("ping", "relay", "run")}
        host = hostile.get("host")
        host = host if isinstance(host, list) else [host]
        write_trace(runs / "ping.mcap", [texts["ping"]], [texts["run"]], ping_events(MESSAGES), host=host)
        write_trace(runs / "relay.mcap", [texts["relay"]], (), relay_events(MESSAGES), host=host)
        try:
            analysis = analyze(runs)
        except TraceError:
            return
        for kind in REPORT_MODULES:
            report_as(kind, analysis).encode()


def _parse(kind: type[Session | Run], text: str) -> None:
    try:
        described = kind.from_json(text, "a file")
    except TraceError as err:
        must_name("a file", err)
        return
    again = kind.from_json(described.to_json(), "a file")
    if again.to_json() != described.to_json():
        raise AssertionError(f"written and read again it is another: {again} and {described}")

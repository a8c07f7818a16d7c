"""Fuzz target `state`: a `state.json` is the state of a sweep, or refused with one line; a watched folder has a status either way."""

import json
from dataclasses import asdict
from pathlib import Path

from fuzz_shapes import changed_fields, must_name, shaped, shaped_seeds

from dds_trace.base.errors import OptionError, TraceFormatError
from dds_trace.extensions.campaigns.run.result import CellResult
from dds_trace.extensions.campaigns.run.state import CellState, Status, SweepState
from dds_trace.extensions.live.live import sweep_status

RESULT = CellResult("ff", 4, 4, 3, 132_000, 10.0, {"p50": 1.5}, None, 0, cut_off=False)


class Target:
    def __init__(self, folder: Path) -> None:
        self._path = folder / "state.json"
        state = SweepState(self._path, "plan", "d1")
        state["a"] = CellState(Status.RECORDED, run_id="ff", segment="1-17-1.mcap", result=RESULT)
        state["b"] = CellState(Status.FAILED, attempts=2, reason="no echo", run_id="fe")
        self._good = json.loads(self._path.read_text())
        assert self._good["cells"]["a"]["result"].keys() == asdict(RESULT).keys()
        self._shapes = (self._text, self._changed, self._nested)

    def try_input(self, data: bytes) -> None:
        """Read the state that the bytes stand for, as a sweep that goes on and as `watch`."""
        self._path.unlink()
        shaped(self._shapes, data)
        status = sweep_status(self._path.parent)
        json.dumps([status.done, status.planned, status.words, status.running], allow_nan=False)
        content = self._path.read_bytes()
        try:
            state = SweepState(self._path, "plan", "d1")
        except (TraceFormatError, OptionError) as err:
            must_name(self._path.parent, err)
            assert self._path.read_bytes() == content
            return
        for segment in state.segments:
            assert "/" not in segment
            state.in_segment(segment)

    def seeds(self) -> dict[str, bytes]:
        return shaped_seeds(
            self._shapes,
            {self._text: json.dumps(self._good).encode(), self._changed: bytes(3), self._nested: b"\0\0{[1e400"},
        )

    def _text(self, data: bytes) -> None:
        self._path.write_bytes(data)

    def _changed(self, data: bytes) -> None:
        self._path.write_text(json.dumps(changed_fields(self._good, data)), errors="replace")

    def _nested(self, data: bytes) -> None:
        """The first two bytes are how often the others are repeated."""
        self._path.write_bytes(data[2:] * (int.from_bytes(data[:2], "little") % 20_000))

"""Fuzz target `limits`: a file of limits makes gates of results or of a recording, or is refused with one line that names it."""

from pathlib import Path

from fuzz_plan import toml
from fuzz_shapes import changed_fields, shaped, shaped_seeds

from dds_trace.base.errors import OptionError
from dds_trace.base.toml_table import TomlTable
from dds_trace.extensions.gates.limits_file import read_limits

LIMITS = """
[thresholds]
latency_p99 = ["< 50ms", "< +20%"]
received_ratio = "> 99 %"
[thresholds."payload_bytes=33000 rate_hz=10"]
latency_p50 = "< 2ms"
[thresholds."/camera/*"]
rate = "> 9 Hz"
missing = "< 0.5 %"
age_p99 = "< 100ms"
[[accepted]]
result = "backend=ros2"
latency_p99 = "< 70ms"
reason = "a slower disk"
commit = "abc"
"""
NAMES = ["latency_p99", "latency_p50", "age_p99", "received_ratio", "rate", "missing", "throughput", "duplicates"]


class Target:
    def __init__(self, folder: Path) -> None:
        self._path = folder / "limits.toml"
        self._shapes = (self._text, self._changed, self._condition, self._result)
        self._text(LIMITS.encode())
        for of_recording in (False, True):  # imports count in no input's time
            assert read_limits(self._path, of_recording=of_recording)

    def try_input(self, data: bytes) -> None:
        """Read the limits that the bytes stand for."""
        shaped(self._shapes, data)
        for of_recording in (False, True):
            try:
                gates = read_limits(self._path, of_recording=of_recording)
            except OptionError as err:
                if "\n" in str(err):
                    raise AssertionError(f"the error has several lines: {err}") from err
                continue
            for gate in gates:
                assert gate.text

    def seeds(self) -> dict[str, bytes]:
        return shaped_seeds(
            self._shapes,
            {
                self._text: LIMITS.encode(),
                self._changed: bytes(3),
                self._condition: b"\0< 50ms",
                self._result: b"payload_bytes=33000 rate_hz=1*",
            },
        )

    def _text(self, data: bytes) -> None:
        self._path.write_bytes(data)

    def _changed(self, data: bytes) -> None:
        good = dict(TomlTable.parse(LIMITS, "the limits").values)
        self._path.write_text(toml(changed_fields(good, data)), errors="replace")

    def _condition(self, data: bytes) -> None:
        """The first byte is the number of a name, the others are what it has to be."""
        name, condition = NAMES[data[0] % len(NAMES) if data else 0], data[1:].decode(errors="replace")
        self._path.write_text(toml({"thresholds": {name: condition, "/t": {name: condition}}}), errors="replace")

    def _result(self, data: bytes) -> None:
        named = {data.decode(errors="replace"): {"latency_p50": "< 1ms", "missing": "< 1 %"}}
        self._path.write_text(toml({"thresholds": named}), errors="replace")

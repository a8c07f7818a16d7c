"""Fuzz target `ring`: `--recover` makes a closed trace of any ring, beside a file or alone, or says in a `TraceError` why not."""

from pathlib import Path

from fuzz_reader import small_ring
from fuzz_shapes import changed, must_name, shaped, shaped_seeds
from trace_files import Message, ping_events, ping_session, run, write_trace

from dds_trace.base.errors import TraceError
from dds_trace.extensions.bags.recover_trace import recover
from dds_trace.tracefile.format.ring import ring_path
from dds_trace.tracefile.reading.reader import read_trace


class Target:
    def __init__(self, folder: Path) -> None:
        self._trace = folder / "t.mcap"
        self._recovered = folder / "recovered.mcap"
        self._ring = small_ring(folder)
        self._file = write_trace(
            folder / "seed.mcap",
            ping_session(),
            [run()],
            ping_events([Message(n, t1=n) for n in range(12)]),
            chunk_bytes=400,
        ).read_bytes()
        self._file = self._file.replace(b"dds-trace tests", b"dds-trace 1.0.0")
        self._shapes = (self._alone, self._changed, self._beside_cut_file, self._beside_changed_file)

    def try_input(self, data: bytes) -> None:
        """Recover what the bytes stand for; what comes out is whole and has the events that the report counts."""
        for path in (self._trace, ring_path(self._trace), self._recovered):
            path.unlink(missing_ok=True)
        shaped(self._shapes, data)
        try:
            report = recover(self._trace, self._recovered)
        except TraceError as err:
            must_name(self._trace.name, err)
            return
        if report.recovered is None:
            return
        trace = read_trace(report.recovered)
        if trace.truncated is not None or trace.event_count != report.file_events + report.ring_events:
            raise AssertionError(f"{trace.truncated}, {trace.event_count} events, {report}")

    def seeds(self) -> dict[str, bytes]:
        return shaped_seeds(
            self._shapes,
            {
                self._alone: self._ring,
                self._changed: bytes(3),
                self._beside_cut_file: (900).to_bytes(2, "little") + self._ring,
                self._beside_changed_file: bytes(30),
            },
        )

    def _alone(self, data: bytes) -> None:
        ring_path(self._trace).write_bytes(data)

    def _changed(self, data: bytes) -> None:
        ring_path(self._trace).write_bytes(changed(self._ring, data))

    def _beside_cut_file(self, data: bytes) -> None:
        """The bytes are a ring beside a file, cut off where the first two say."""
        self._trace.write_bytes(self._file[: int.from_bytes(data[:2], "little") % len(self._file)])
        ring_path(self._trace).write_bytes(data[2:])

    def _beside_changed_file(self, data: bytes) -> None:
        """The bytes are changes to a file without its end; the ring beside it is good."""
        self._trace.write_bytes(changed(self._file[:-300], data))
        ring_path(self._trace).write_bytes(self._ring)

"""A tap's recording from its options to a closed trace."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from contextlib import ExitStack

from dds_trace.base.errors import OptionError
from dds_trace.base.units import counted, format_duration
from dds_trace.tracefile.format.json_fields import JsonObject
from dds_trace.tracefile.writing.destination import discard

from ..applied.carried import Traffic
from ..backends.node import Node, TapNode, TopicPatterns
from ..base_recording import LOOK_S, BaseRecording, Recorded, raise_error_of, sampled
from ..errors import NothingHeardError
from ..host.process import tuned_gc
from ..options import TapOptions
from ..roles.live import LiveTable
from ..roles.progress import TapProgress
from ..roles.read_back import ReadBack
from ..service.upkeep import Upkeep
from .page import open_diagnostics, serve_page
from .tap import Tap, summarize


class OwnUse:
    """Counts from its making."""

    def __init__(self) -> None:
        self._cpu_ns, self._start_ns = time.process_time_ns(), time.monotonic_ns()

    def taken(self, messages: int) -> tuple[JsonObject, str]:
        """Return the session's field `own_cost` so far, and one line for the user."""
        cpu_ns, duration_ns = time.process_time_ns() - self._cpu_ns, time.monotonic_ns() - self._start_ns
        of_message = f", {format_duration(cpu_ns / messages)} for each message" if messages else ""
        words = f"the tap itself used {cpu_ns / max(duration_ns, 1):.1%} of one core{of_message}"
        return {"cpu_ns": cpu_ns, "duration_ns": duration_ns, "messages": messages}, words


LONELY_S = 5.0
"""Wait for a publisher until the user gets a line about it."""
COLLECT_LOOKS = 60
"""Garbage is collected after so many checks."""


class TapRecording(BaseRecording):
    """The recording of a tap."""

    def record(self, tap_options: TapOptions) -> Recorded:
        """Listen until done; errors as for `recorder.recording.record`.

        With `NothingHeardError` in the result no message came, and there is no trace.
        """
        options = self.options
        self.measure_costs(has_floor=False)
        with self.open_wire() as wire, self.open_node("tap") as node, tuned_gc():
            if not isinstance(node, TapNode):
                raise OptionError(
                    f"--role tap: the backend {options.backend} only carries our own messages; use ros2, cyclonedds or zenoh"
                )
            read_back = self.read_back(node)
            session = self.describe("tap", node, read_back, extra={"topics": list(tap_options.topics)})
            publish = open_diagnostics(node, options.device or "") if tap_options.diagnostics else None
            with ExitStack() as stack:
                upkeep = stack.enter_context(Upkeep(options, session, self.clock.monotonic_ns, self.watch.note))
                live = LiveTable(tap_options.expected_hz)
                tap = Tap(
                    node,
                    upkeep.sink,
                    TopicPatterns(tap_options.topics),
                    session_id=self.session_id,
                    qos=options.tap_qos,
                    note=self.watch.note,
                    live=live,
                    clock=self.clock,
                    has_worker=True,
                    keeps_payload=tap_options.payload,
                )
                if tap_options.live_port is not None:
                    address = stack.enter_context(serve_page(tap_options.live_port, live.rows))
                    self.watch.note(f"live on {address}")
                read_back.read_begin()
                node.start()
                use = OwnUse()
                if self.rehearses:
                    self.stop.set()
                else:
                    self.watch.note(f"listening to {', '.join(tap_options.topics)} in domain {options.node.domain_id}")
                with sampled(upkeep.sink, wire):
                    self._watch_tap(tap, node, upkeep, read_back, live, publish)
                tap.close()
                own_cost, cost_words = use.taken(tap.messages)
                mean_bytes = sum(stream.payload_bytes for stream in tap.streams) // max(tap.messages, 1)
                read_back.read_end(Traffic(0, tap.messages, mean_bytes))
                left_out = upkeep.sink.payloads.left_out
                counts: JsonObject = {"payloads_left_out": left_out} if tap_options.payload else {}
                trace = upkeep.close_trace(**read_back.fields(), **self.fields_at_end(), own_cost=own_cost, **counts)
                read_back.report(trace.path)
                progress = self._progress(tap, live)
                if self.rehearses:
                    return Recorded(trace, session, progress)
                if not tap.messages:  # the next try may have the name
                    discard(upkeep.destination)
                    return Recorded(None, session, progress, error=NothingHeardError(self._why_nothing(tap, node)))
                lost = [f"{counted(left_out, 'payload')} left out: too many waited for the disk"] if left_out else []
                for line in (*summarize(tap.streams), *lost, cost_words):
                    self.watch.note(line)
                return Recorded(trace, session, progress, error=upkeep.shortage)

    def _watch_tap(
        self,
        tap: Tap,
        node: Node,
        upkeep: Upkeep,
        read_back: ReadBack,
        live: LiveTable,
        publish: Callable[[LiveTable], None] | None,
    ) -> None:
        end_ns, looks, began_s, is_noted = self.end_ns(), 0, time.monotonic(), False
        tap.look()
        while (left_s := self.left_s(end_ns)) > 0 and not self.stop.wait(min(LOOK_S, left_s)):
            raise_error_of(node)
            tap.look()
            self.note_disk(upkeep.sink)
            read_back.report()
            upkeep.look(tap.messages, read_back.fields)
            self.watch.progress(self._progress(tap, live))
            looks += 1
            if publish is not None and looks % 2:
                publish(live)
            if not tap.messages and not is_noted and time.monotonic() - began_s > LONELY_S:
                is_noted = True
                self.watch.note(f"{self._why_nothing(tap, node)}; the tap joins a topic as soon as it appears")
            if looks % COLLECT_LOOKS == 0:
                gc.collect()
        tap.look()

    def _progress(self, tap: Tap, live: LiveTable) -> TapProgress:
        missing = sum(stream.missing for stream in tap.streams)
        assert self.options.tap is not None
        return TapProgress(
            tap.messages, len(tap.topics), len(tap.streams), missing, live.rows() if self.options.tap.live else ()
        )

    def _why_nothing(self, tap: Tap, node: Node) -> str:
        """Return one line about a tap without a message: what it looked for, saw, and what to try."""
        assert self.options.tap is not None
        names, domain_id = ", ".join(self.options.tap.topics), node.options.domain_id
        if tap.refused:
            return "; ".join(f"{topic}: {why}" for topic, why in sorted(tap.refused.items()))
        if tap.topics:
            return f"no message of {', '.join(tap.topics)} came: its publishers are there and silent, or the network drops what they send"
        count = node.count_participants()
        others = "an unknown number of other nodes" if count is None else f"{count - 1} other nodes"
        return (
            f"no publisher of {names} in domain {domain_id} ({others} seen): check name, --domain, --discovery and --backend; in a "
            "secured domain give this process its keys (ROS_SECURITY_KEYSTORE, ROS_SECURITY_ENABLE=true)"
        )

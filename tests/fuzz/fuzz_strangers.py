"""Target `strangers`: what a graph announces to a tap, notes of beacons, and a working folder's `dds-trace.toml`.

A topic is joined or refused in one printable line, a note is believed or ignored, a file is read or refused with its name.
"""

from contextlib import suppress
from pathlib import Path

import typer
from fake_clock import FakeClock
from fake_tap_node import FakeTapNode, JsonSink
from fuzz_shapes import shaped, shaped_seeds

from dds_trace.base.errors import OptionError
from dds_trace.base.printable import is_hidden
from dds_trace.cli.defaults import FILE_NAME, configurable, read_defaults
from dds_trace.cli.record.command import app
from dds_trace.extensions.topics.exchange import Exchanges
from dds_trace.extensions.topics.tap import Tap
from dds_trace.recorder.backends.node import Publication, TopicPatterns
from dds_trace.recorder.backends.other_side import Strangers
from dds_trace.recorder.backends.zenoh_ros import parse_token
from dds_trace.recorder.options import chosen_qos
from dds_trace.tracefile.format.encoding import encode_string

TOKEN = "@ros2_lv/0/aa/0/1/MP/%/%/driver/%camera/sensor_msgs::msg::dds_::Image_/RIHS01_aa/::,10:,:,:,,"
NOTE = (
    '{"device": "a", "run_id": "7", "sequence": 3, "relay_id": 9, "relay_in_ns": 5, "relay_out_ns": 6, '
    '"wall_offset_ns": 7, "time_service": "b"}'
)


class Target:
    def __init__(self, folder: Path) -> None:
        self._file = folder / FILE_NAME
        self._shapes = (self._announced, self._noted, self._defaults)
        self._options = configurable(typer.main.get_command(app))

    def seeds(self) -> dict[str, bytes]:
        toml = b"[record]\nrate = 5\ntopics = ['/a']\nlabel = ['a=b']\n[sweep]\n"
        return shaped_seeds(
            self._shapes, {self._announced: TOKEN.encode(), self._noted: encode_string(NOTE), self._defaults: toml}
        )

    def try_input(self, data: bytes) -> None:
        shaped(self._shapes, data)

    def _announced(self, data: bytes) -> None:
        text, node, notes = data.decode(errors="surrogateescape"), FakeTapNode(), list[str]()
        topic, _, type_name = text.partition("\n")
        node.graph = [Publication(topic, type_name), *filter(None, [parse_token(text)])]
        qos = chosen_qos(None, None, None)
        tap = Tap(node, JsonSink(), TopicPatterns(("*",)), session_id=1, qos=qos, note=notes.append, clock=FakeClock())
        tap.look()
        tap.close()
        assert not any(map(is_hidden, "".join(notes)))

    def _noted(self, data: bytes) -> None:
        exchanges = Exchanges(Strangers())
        exchanges.run_ids.add(7)
        exchanges.note_sent(7, 3, 1)
        exchanges.take_note(data)
        exchanges.note_reply(7, 3, 9, 20)
        assert not any(map(is_hidden, "".join(exchanges.words(30, 0))))

    def _defaults(self, data: bytes) -> None:
        self._file.write_bytes(data)
        with suppress(OptionError):
            read_defaults([self._file], "record", self._options)

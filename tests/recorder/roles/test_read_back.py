import pytest
from fake_node import FakeNode
from snapshots import applied, counted, segment, udp

from dds_trace.base.records import to_json
from dds_trace.recorder.applied.applied import Traffic
from dds_trace.recorder.applied.differences import Difference, Setting
from dds_trace.recorder.backends.node import Middleware, NodeOptions
from dds_trace.recorder.choices import Transport
from dds_trace.recorder.errors import NotAppliedError
from dds_trace.recorder.roles import read_back
from dds_trace.recorder.roles.read_back import ReadBack


class Bench:
    """A role on Fast DDS that was asked for UDP; `seen` is what its process uses."""

    def __init__(self, monkeypatch, *, strict=False, transport=Transport.UDP):
        self.node = FakeNode(NodeOptions(5, transport=transport))
        self.node.middleware = Middleware("ros2", "fastdds", "rmw_fastrtps_cpp")
        self.notes, self.reads = [], 0
        self.seen = applied(sockets=(udp(8660),), begin=counted(lo=(0, 0)))
        self.ended = applied(begin=counted(lo=(0, 0)), end=counted(lo=(0, 0)))
        monkeypatch.setattr(read_back, "read_applied", self.read)
        self.read_back = ReadBack(self.node, {}, strict=strict, note=self.notes.append)

    def read(self, begun=None):
        self.reads += 1
        return self.seen if begun is None else self.ended

    def end(self):
        self.ended = applied(memory=(segment(),), begin=counted(lo=(0, 0)), end=counted(lo=(9, 9)))
        self.read_back.read_end(Traffic(100, 100, 100_000))


@pytest.fixture
def bench(monkeypatch):
    return Bench(monkeypatch)


def test_before_it_is_read_the_session_holds_the_wish_alone(bench):
    bench.read_back.read_end(Traffic(1, 1, 1))  # a relay that was never asked
    assert list(bench.read_back.fields()) == ["asked"]
    assert bench.read_back.fields()["asked"]["transport"] == "udp"
    assert bench.reads == 0


class Stop:
    def __init__(self, third=lambda: None):
        self.waits, self.third = [], third

    def wait(self, seconds):
        self.waits.append(seconds)
        if len(self.waits) == 3:
            self.third()
        return False


def test_a_relay_learns_of_its_first_probe_at_once(monkeypatch):
    bench, quiet = Bench(monkeypatch), Stop()
    assert not bench.read_back.wait(quiet, 0.5)
    assert sum(quiet.waits) == pytest.approx(0.5)
    bench.seen = applied(sockets=(udp(8660),), memory=(segment(),))
    probed = Stop(bench.read_back.read_begin)
    assert not bench.read_back.wait(probed, 0.5)
    assert probed.waits == [read_back.NEWS_S] * 3 + [0]
    bench.read_back.report()
    told = Stop()
    assert not bench.read_back.wait(told, 0.5)
    assert told.waits == [0.5]


def test_what_a_bridge_does_not_use_is_told_and_kept_beside_the_own(monkeypatch):
    bench = Bench(monkeypatch, transport=Transport.DEFAULT)
    of_bridge = Difference(Setting.TUNED, "builtin: 8000000", "212992", "the bridge builtin: asked for buffers")
    bench.read_back.read_begin()
    bench.read_back.note_bridge((of_bridge,))
    bench.read_back.report()
    bench.read_back.read_end(Traffic(1, 1, 1))
    bench.read_back.note_bridge((of_bridge,))
    bench.read_back.report()
    (note,) = bench.notes
    assert note.startswith(f"not applied: {of_bridge.words}")
    assert bench.read_back.fields()["not_applied"] == [to_json(of_bridge)]


def test_an_honest_run_tells_nothing(monkeypatch):
    bench = Bench(monkeypatch, strict=True)
    bench.read_back.read_begin()
    bench.read_back.report()
    fields = bench.read_back.fields()
    assert fields["not_applied"] == bench.notes == []
    assert fields["applied"]["begin"]["sockets"][0]["local_port"] == 8660
    assert fields["applied"]["end"] is None


def test_a_difference_is_told_once_and_kept(bench):
    bench.seen = applied(sockets=(udp(8660),), memory=(segment(),))
    bench.read_back.read_begin()
    for _ in range(2):
        bench.read_back.report()
    (note,) = bench.notes
    (difference,) = bench.read_back.fields()["not_applied"]
    assert difference["setting"] == "transport"
    assert note.startswith(f"not applied: {difference['words']}")


def test_other_words_for_the_same_setting_at_the_end_are_no_news(bench):
    bench.seen = applied(memory=(segment(),), begin=counted(lo=(0, 0)))
    bench.read_back.read_begin()
    bench.read_back.report()
    bench.end()
    bench.read_back.report()
    assert len(bench.notes) == 1
    (difference,) = bench.read_back.fields()["not_applied"]
    assert difference["applied"] == "the bytes went through shared memory"
    assert bench.read_back.fields()["applied"]["path"] == "shm"


def test_strict_ends_the_recording(monkeypatch):
    bench = Bench(monkeypatch, strict=True)
    bench.seen = applied(memory=(segment(),))
    bench.read_back.read_begin()
    with pytest.raises(NotAppliedError, match=r"^-o strict=true: asked for UDP, shared memory is open"):
        bench.read_back.report()
    assert bench.notes == []


def test_strict_names_the_trace_of_a_setting_that_only_the_end_shows(monkeypatch, tmp_path):
    bench = Bench(monkeypatch, strict=True)
    bench.read_back.read_begin()
    bench.read_back.report()
    bench.end()
    with pytest.raises(NotAppliedError, match=r"shared memory \(seen at the end: .*ping\.mcap is complete"):
        bench.read_back.report(tmp_path / "ping.mcap")


def test_the_beginning_is_read_once(bench):
    for _ in range(3):  # three pings look for their echo one after the other
        bench.read_back.read_begin()
    assert bench.reads == 1


def test_a_setting_may_explain_why_no_echo_comes(bench):
    assert bench.read_back.explain(Traffic(20, 0, 33_000)) == ()
    bench.seen = applied(memory=(segment(),))
    (difference,) = bench.read_back.explain(Traffic(20, 0, 33_000))
    assert difference.words.startswith("asked for UDP, ")

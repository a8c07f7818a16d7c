import base64
import json
import subprocess
import sys

import pytest
from bags import ROS2, imu
from one_row import with_rows

from dds_trace.extensions.bags.kinds import RECORDING_KINDS, function_at

MS = 1_000_000

KIND = {
    '    RecordingKind(\n        "a ROS 1 bag"': """\
    RecordingKind("a text", ".jsonl", b'{"topic":', "jsonl:read", "jsonl:recover"),
"""
}
MODULE = """
import base64, json

from dds_trace.tracefile.format.bag_metadata import RecordedTopic
from dds_trace.extensions.bags.recorded import RawMessage, batched


def messages(path, condition):
    for line in path.read_text().splitlines():
        try:
            record = json.loads(line)
        except ValueError:
            condition.damages.append("a line is no message")
            continue
        topic = RecordedTopic(record["topic"], record["type"], "cdr")
        condition.topics.add(topic)
        yield RawMessage(topic, record["at"], None, None, base64.b64decode(record["data"]))


def read(path, condition):
    return batched(messages(path, condition))


def recover(path, new):
    from dds_trace.extensions.bags.recorded import Condition

    condition = Condition()
    with new.path.open("x") as stream:
        for message in messages(path, condition):
            record = {"topic": message.topic.name, "type": message.topic.message_type, "at": message.log_ns}
            stream.write(json.dumps(record | {"data": base64.b64encode(message.data).decode()}) + "\\n")
            new.add(message.topic, 1, message.log_ns, message.log_ns)
    return condition.damages, 0
"""


@pytest.fixture
def dds_trace(tmp_path):
    environment = with_rows(tmp_path, "extensions/bags/kinds.py", KIND) | {"COLUMNS": "100"}
    bags = tmp_path / "changed" / "dds_trace" / "extensions" / "bags"
    (bags / "jsonl.py").write_text(MODULE.replace("\\\\n", "\\n"), encoding="utf-8")

    def ran(*words):
        command = [sys.executable, "-c", "from dds_trace.cli.trace import main; main()", *map(str, words)]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)

    return ran


@pytest.mark.parametrize("kind", RECORDING_KINDS, ids=lambda kind: kind.suffix)
def test_a_row_has_functions_that_read_and_recover(kind):
    assert callable(function_at(kind.read))
    assert callable(function_at(kind.recover))


def test_a_kind_of_recording_is_one_row(dds_trace, tmp_path):
    path = tmp_path / "drive" / "x.jsonl"
    path.parent.mkdir()
    data = base64.b64encode(ROS2.serialize_cdr(imu(0.1), "sensor_msgs/msg/Imu")).decode()
    record = {"topic": "/imu", "type": "sensor_msgs/msg/Imu"}
    lines = [json.dumps(record | {"at": n * 10 * MS, "data": data}) for n in range(1, 201) if n not in (90, 91)]
    path.write_text("\n".join([*lines, "{torn"]) + "\n", encoding="utf-8")

    ran = dds_trace("bag", path.parent, "--report", "json", "--out", tmp_path / "out")
    assert ran.returncode == 31, ran.stderr  # damaged
    report = json.loads((tmp_path / "out" / "topics.json").read_text(encoding="utf-8"))
    assert "/imu" in json.dumps(report)
    ran = dds_trace("recover", path)
    assert ran.returncode == 0, ran.stderr
    assert "198 messages" in ran.stdout
    assert (tmp_path / "drive" / "x.recovered.jsonl").read_text(encoding="utf-8").splitlines() == lines

    assert ".mcap, .jsonl, .bag or .db3" in dds_trace("bag", "--help").stdout
    (tmp_path / "empty").mkdir()
    ran = dds_trace("bag", tmp_path / "empty")
    assert ran.returncode != 0
    (tmp_path / "other.jsonl").write_text("what", encoding="utf-8")
    assert "Traceback" not in dds_trace("recover", tmp_path / "other.jsonl").stderr

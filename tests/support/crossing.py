"""Real ROS 2 nodes that show which topics cross between two domains.

`watch_crossing` runs this file as a process of its own, because rclpy's wheels start Python anew on import. In it, a
sender in the first domain publishes on every topic, a listener there hears it (the control), an echoer in the second
domain answers on the `_relay` twin, and the sender counts the answers.
"""

import json
import sys
import time
from dataclasses import dataclass
from threading import Event

from processes import executed
from waiting import PATIENCE_S

CDR_HEADER = b"\x00\x01\x00\x00"


@dataclass(frozen=True)
class Crossing:
    """Messages of each topic: `sent`, `heard` in the sender's own domain, `crossed` to the other, `echoed` back."""

    sent: dict[str, int]
    heard: dict[str, int]
    crossed: dict[str, int]
    echoed: dict[str, int]


def watch_crossing(first, second, topics, *, until, count=5, reliability="reliable"):
    """What was seen when all that `until` names had been seen `count` times.

    Args:
        topics: name -> type name.
        until: names of topics by what must be seen of them: {"echoed": [...], "heard": [...]}.
    """
    order = json.dumps(
        {"first": first, "second": second, "topics": topics, "until": until, "count": count, "reliability": reliability}
    )
    ran = executed([sys.executable, __file__, order], timeout=PATIENCE_S + 30)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return Crossing(**json.loads(ran.stdout))


def main(*, first, second, topics, until, count, reliability):
    from dds_trace.recorder.backends import open_node
    from dds_trace.recorder.backends.node import NodeOptions
    from dds_trace.recorder.choices import Discovery
    from dds_trace.tracefile.format.descriptions import Qos

    def open_one(domain_id, name):
        qos = Qos(reliability=reliability)
        return open_node("ros2", NodeOptions(domain_id, name=name, discovery=Discovery.LOCALHOST, qos=qos))

    seen = {kind: dict.fromkeys(topics, 0) for kind in ("sent", "heard", "crossed", "echoed")}
    with (
        open_one(first, "sender") as sender,
        open_one(first, "listener") as listener,
        open_one(second, "echoer") as echoer,
    ):

        def on(kind, topic, answer=None):
            def receive(message, *_):
                seen[kind][topic] += 1
                if answer is not None:
                    answer.publish(message)

            return receive

        publishers = []
        for topic, type_name in topics.items():
            publishers.append((topic, sender.create_publisher(topic, type_name)))
            listener.create_subscription(topic, type_name, on("heard", topic))
            answer = echoer.create_publisher(f"{topic}_relay", type_name)
            echoer.create_subscription(topic, type_name, on("crossed", topic, answer))
            sender.create_subscription(f"{topic}_relay", type_name, on("echoed", topic))
        for node in (sender, listener, echoer):
            node.start()
        pause = Event()
        deadline = time.monotonic() + PATIENCE_S
        while any(seen[kind][name] < count for kind, names in until.items() for name in names):
            assert time.monotonic() < deadline, f"not seen in time: {seen}"
            for topic, publisher in publishers:
                seen["sent"][topic] += 1
                publisher.publish(CDR_HEADER + bytes(64))
            pause.wait(0.05)
    print(json.dumps(seen))


if __name__ == "__main__":
    main(**json.loads(sys.argv[1]))

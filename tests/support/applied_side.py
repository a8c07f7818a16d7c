"""One side of a small ping and relay that reads back what it uses, run as a process by `applied_pair`.

Its one argument is a JSON object; its one result is a JSON object on the last line of stdout. The relay says `ready`, and
ends when its stdin is closed.
"""

import json
import os
import sys
import threading
import time
from contextlib import nullcontext

from dds_trace.base.records import from_json, to_json
from dds_trace.recorder.applied.applied import Traffic, read_applied, with_path
from dds_trace.recorder.applied.asked import Asked, asked_settings
from dds_trace.recorder.applied.differences import differences
from dds_trace.recorder.backends import load_backend, open_node, ros2, zenoh
from dds_trace.recorder.backends.node import NodeOptions
from dds_trace.recorder.choices import Discovery, Transport
from dds_trace.recorder.payloads import BINARY
from dds_trace.tracefile.format.descriptions import Qos

TOPIC, BACK = "applied_there", "applied_back"
MEET_S = 0.5
"""Until both sides have found each other, a message is sent again and again."""
ECHO_S = 10.0
"""Bound on the echo of a measured message; only a lost one takes that long."""


class Side:
    """Both roles: a node whose settings are those of the product, or `environment` where a test replaces them."""

    def __init__(self, given):
        self.given = given
        if given["environment"] is not None:  # what the product would set, replaced by what is tried
            ros2.installation.set_discovery_range = lambda _: os.environ.update(given["environment"])
            ros2.applied_transport = lambda *_: nullcontext({})
        if given["zenoh_memory"] is not None:
            inner = zenoh.zenoh_configuration
            memory = {"transport": {"shared_memory": {"enabled": given["zenoh_memory"]}}}
            zenoh.zenoh_configuration = lambda options: {**inner(options), **memory}
        users_own = dict(os.environ)
        udp_socket = given["backend"] == "socket" and given["transport"] == "udp"
        self.node = open_node(
            given["backend"],
            NodeOptions(
                domain_id=given["domain_id"],
                name=given["role"],
                discovery=Discovery(given["discovery"]),
                qos=Qos(reliability="best_effort" if udp_socket else "reliable"),
                transport=Transport(given["transport"]),
                tuned=given["tuned"],
                listens=given["role"] == "relay",
            ),
        )
        asked = asked_settings(
            self.node.middleware.vendor,
            domain_id=given["domain_id"],
            transport=given["transport"],
            tuned=given["tuned"],
            discovery=given["discovery"],
            environment=users_own,
            settings=self.node.middleware.settings,
            profile=load_backend(given["backend"]).profile_of(self.node.middleware.rmw, users_own)[0],
        )
        self.asked = from_json(Asked, {**to_json(asked), **given["asked"]})
        self.count = 0
        self.arrived = threading.Event()

    def relay(self):
        with self.node as node:
            publisher = node.create_publisher(BACK, BINARY.type_name)

            def send_back(message, *_):
                self.count += 1
                publisher.publish(message)

            node.create_subscription(TOPIC, BINARY.type_name, send_back)
            node.start()
            begun = read_applied()
            print("ready", flush=True)
            sys.stdin.read()
            return self.report(begun, Traffic(self.count, self.count, self.given["payload_bytes"]))

    def ping(self):
        message = BINARY.make(self.given["payload_bytes"], 1).messages[0].data
        with self.node as node:
            node.create_subscription(BACK, BINARY.type_name, self._count)
            publisher = node.create_publisher(TOPIC, BINARY.type_name)
            node.start()
            for number in range(self.given["attempts"]):
                if self._exchange(publisher, message, MEET_S):
                    break
                in_vain = Traffic(number + 1, 0, self.given["payload_bytes"])
                begun = read_applied()
                # At once: Fast DDS forgets a participant that it has not heard for 20 s, and the port that it served. What
                # differs without a message, too, does not explain that none comes: the two may not have met yet.
                explained = set(differences(self.asked, begun, in_vain)) - set(differences(self.asked, begun))
                if number + 1 == self.given["attempts"] or explained:
                    # No second look: Fast DDS drops the port of a side that it cannot reach now and then, and opens it anew.
                    return self.report(begun, in_vain, begun)
            while number and self._hears_more():  # late echoes of earlier attempts are none of what follows
                pass
            begun, before = read_applied(), self.count
            took_ms = []
            for _ in range(self.given["messages"]):
                began_ns = time.monotonic_ns()
                if self._exchange(publisher, message, ECHO_S):
                    took_ms.append((time.monotonic_ns() - began_ns) / 1e6)
                time.sleep(self.given["period_s"])
            traffic = Traffic(self.given["messages"], self.count - before, self.given["payload_bytes"])
            return {**self.report(begun, traffic), "rtt_ms": sorted(took_ms)}

    def _count(self, *_):
        self.count += 1
        self.arrived.set()

    def _hears_more(self):
        self.arrived.clear()
        return self.arrived.wait(MEET_S)

    def _exchange(self, publisher, message, patience_s):
        self.arrived.clear()
        publisher.publish(message)
        return self.arrived.wait(patience_s)

    def report(self, begun, traffic, ended=None):
        applied = with_path(ended or read_applied(begun), traffic)
        return {
            "asked": to_json(self.asked),
            "applied": to_json(applied),
            "traffic": [traffic.sent, traffic.received, traffic.payload_bytes],
            "at_begin": [_plain(each) for each in differences(self.asked, begun)],
            "at_end": [_plain(each) for each in differences(self.asked, applied, traffic)],
        }


def _plain(difference):
    return [difference.setting.value, difference.words]


if __name__ == "__main__":
    arguments = json.loads(sys.argv[1])
    print(json.dumps(getattr(Side(arguments), arguments["role"])()), flush=True)

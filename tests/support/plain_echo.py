"""A relay of the `socket` backend's TCP written apart from it, with stamps of its own and a known delay of every other message.

    python plain_echo.py PORT TOPIC TYPE DELAY_S

Prints `ready`, then `run sequence in_ns out_ns` (CLOCK_MONOTONIC) for each message, until its peer goes.
"""

import json
import socket
import struct
import sys
import time

RELAY_ID = 7


def read_exactly(connection, size):
    data = b""
    while len(data) < size:
        part = connection.recv(size - len(data))
        if not part:
            sys.exit(0)
        data += part
    return data


def write_frame(connection, name, body):
    connection.sendall(struct.pack("<IH", len(body), len(name)) + name + body)


def main(port, topic, type_name, delay_s):
    back = topic + "_relay"
    with socket.create_server(("127.0.0.1", port)) as server:
        print("ready", flush=True)
        connection, _ = server.accept()
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    greeting = {"name": "plain", "subscriptions": {topic: type_name}, "publishers": {back: type_name}}
    write_frame(connection, b"", json.dumps(greeting).encode())
    while True:
        body_bytes, name_bytes = struct.unpack("<IH", read_exactly(connection, 6))
        name, body = read_exactly(connection, name_bytes), read_exactly(connection, body_bytes)
        in_ns = time.monotonic_ns()
        if name.decode() != topic:
            continue
        at = body.index(b"dt1:")
        _, run, sequence, _ = body[at : at + 46].split(b":")
        if int(sequence, 16) % 2:
            time.sleep(delay_s)
        reply = body[: at + 38] + b"%08x" % RELAY_ID + body[at + 46 :]
        out_ns = time.monotonic_ns()
        write_frame(connection, back.encode(), reply)
        print(int(run, 16), int(sequence, 16), in_ns, out_ns, flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2], sys.argv[3], float(sys.argv[4]))

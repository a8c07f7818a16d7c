"""Round trips of UDP datagrams between two namespaces: an independent look at a link.

    python udp_echo.py serve
    python udp_echo.py ask ADDRESS BYTES COUNT TIMEOUT_S

`ask` prints `ready`, waits for a line, and prints begin and end of each round trip in nanoseconds, or `lost`.
"""

import socket
import sys
import time

PORT = 9000


def serve():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("0.0.0.0", PORT))
        print("ready", flush=True)
        while True:
            data, sender = server.recvfrom(65536)
            server.sendto(data, sender)


def ask(address, size_bytes, count, timeout_s):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(timeout_s)
        print("ready", flush=True)
        sys.stdin.readline()
        for number in range(count):
            data = number.to_bytes(4, "little").ljust(size_bytes, b"x")
            began_ns = time.monotonic_ns()
            client.sendto(data, (address, PORT))
            try:
                while client.recv(65536)[:4] != data[:4]:
                    pass
            except TimeoutError:
                print("lost", flush=True)
            else:
                print(began_ns, time.monotonic_ns(), flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "serve":
        serve()
    ask(sys.argv[2], int(sys.argv[3]), int(sys.argv[4]), float(sys.argv[5]))

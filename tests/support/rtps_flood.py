"""Sends RTPS packets of one DATA_FRAG each as fast as the line takes them.

rtps_flood.py ADDRESS PACKETS
"""

import socket
import sys

from wire_packets import data_frag, rtps

PAYLOAD_BYTES, FRAGMENTS = 1344, 40


def main() -> None:
    count = int(sys.argv[2])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        content, sample_bytes = bytes(PAYLOAD_BYTES), PAYLOAD_BYTES * FRAGMENTS
        for number in range(count):
            sample, fragment = divmod(number, FRAGMENTS)
            # Not connected: that nobody listens there is told to a connected socket alone.
            packet = rtps(data_frag(sample + 1, fragment + 1, content, sample_bytes))
            out.sendto(packet, (sys.argv[1], 7411))


if __name__ == "__main__":
    main()

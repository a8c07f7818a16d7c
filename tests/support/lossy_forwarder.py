"""A link between two TAP devices that drops IP frames by chance and keeps every frame it saw, with its fate.

    lossy_forwarder.py FD FD LOG LOSS SEED

takes the devices as open file descriptors. LOG gets one record a frame: side (0 or 1), dropped (0 or 1), length, octets.
It ends when standard input closes.
"""

import os
import random
import select
import struct
import sys
from pathlib import Path

RECORD = struct.Struct("<BBI")


def main() -> None:
    taps = [int(text) for text in sys.argv[1:3]]
    loss, chance = float(sys.argv[4]), random.Random(int(sys.argv[5]))
    with Path(sys.argv[3]).open("wb") as log:
        while True:
            ready, _, _ = select.select([sys.stdin.fileno(), *taps], [], [])
            for side, tap in enumerate(taps):
                if tap in ready:
                    frame = os.read(tap, 1 << 16)
                    is_ip = frame[12:14] == b"\x08\x00"  # a lost ARP would cost a second and prove nothing
                    dropped = is_ip and chance.random() < loss
                    log.write(RECORD.pack(side, dropped, len(frame)) + frame)
                    if not dropped:
                        os.write(taps[1 - side], frame)
            if sys.stdin.fileno() in ready:
                return


if __name__ == "__main__":
    main()

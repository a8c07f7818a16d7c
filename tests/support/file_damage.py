"""What can have become of a file that we wrote: functions that do it to the file at a path."""

from __future__ import annotations

import os


def flip_a_bit(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)


def cut(path):
    path.write_bytes(path.read_bytes()[:-1])


def lengthen(path):
    path.write_bytes(path.read_bytes() + b" ")


def make_a_pipe(path):
    path.unlink()
    os.mkfifo(path)


def make_a_link(path):
    path.rename(path.with_suffix(".moved"))
    path.symlink_to(path.with_suffix(".moved"))


DAMAGES = (flip_a_bit, cut, lengthen, make_a_pipe, make_a_link)

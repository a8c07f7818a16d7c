import os
import random
import string
import threading

import pytest

from dds_trace.base.errors import OptionError
from dds_trace.recorder.errors import StoppedError
from dds_trace.recorder.payloads import BINARY, STRING, open_payload
from dds_trace.recorder.payloads import base as payloads_base
from dds_trace.recorder.payloads.stamp import stamp_text

LETTERS = (string.ascii_letters + string.digits).encode()
PIECE = 1 << 20


class StopAtThird(threading.Event):
    looks = 0

    def is_set(self):
        self.looks += 1
        return self.looks >= 3


def load(data, size_bytes=None, stop=None):
    stop = stop or threading.Event()
    with open_payload(data, size_bytes, 3, open_node=lambda: pytest.fail("a node"), wait_s=0, stop=stop) as payload:
        return payload


@pytest.mark.parametrize("data", ["binary", "string"])
@pytest.mark.parametrize("size", [(1 << 30) + 1, 1 << 32, 10**12, 10**400])
def test_size_beyond_what_is_held_is_refused(data, size):
    with pytest.raises(OptionError, match="payload has"):
        load(data, size)


@pytest.mark.parametrize("size", [1, 4, PIECE - 1, PIECE, PIECE + 1, 2 * PIECE + 5])
def test_pieces_are_the_bytes_that_one_draw_gives(size):
    binary, text = (data_type.make(size, 3).messages[0].data for data_type in (BINARY, STRING))
    assert binary.endswith(random.Random(3).randbytes(size))
    assert text.endswith(stamp_text(0, 0) + bytes(random.Random(3).choices(LETTERS, k=size)) + b"\0")


@pytest.mark.parametrize("data", ["binary", "string"])
def test_a_signal_ends_the_making(data):
    stop = StopAtThird()
    with pytest.raises(StoppedError, match="nothing is recorded"):
        load(data, 1 << 30, stop)
    assert stop.looks == 3


def test_a_signal_ends_the_reading_of_a_file(tmp_path):
    with (tmp_path / "large").open("wb") as file:
        file.truncate(payloads_base.MAX_PAYLOAD_BYTES)
    stop = StopAtThird()
    with pytest.raises(StoppedError):
        load(f"file:{tmp_path / 'large'}", stop=stop)
    assert stop.looks == 3


def test_a_file_of_a_terabyte_is_refused(tmp_path):
    with (tmp_path / "sparse").open("wb") as file:
        file.truncate(1 << 40)
    for where in (tmp_path / "sparse", tmp_path):
        with pytest.raises(OptionError, match="more than 1 GiB"):
            load(f"file:{where}")


@pytest.mark.parametrize("device", ["/dev/zero", "/dev/urandom", "/dev/null", "/dev/tty"])
def test_a_device_is_no_file(device):
    with pytest.raises(OptionError, match=device):
        load(f"file:{device}")


@pytest.mark.parametrize("data", ["file:{}", "bag:{}#/topic"])
def test_a_pipe_is_no_file_and_is_not_waited_for(tmp_path, data):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(OptionError, match="pipe"):
        load(data.format(tmp_path / "pipe"))


def test_devices_behind_links_in_a_folder_are_left_out(tmp_path):
    (tmp_path / "a").write_bytes(b"data")
    (tmp_path / "b").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "c")
    assert [message.payload_bytes for message in load(f"file:{tmp_path}").messages] == [4]

"""The disk dies under a recorder: real EIO of a real block device, real read-only ext4; no event is lost, nothing raises."""

from __future__ import annotations

import json
import subprocess
import sys

import dying_disk
import pytest
from forgetful_disk import missing_for_a_disk

from dds_trace.tracefile.format.events import Stage
from dds_trace.tracefile.reading.reader import read_trace
from dds_trace.tracefile.recovery.recover import recover


@pytest.mark.timeout(300)
@pytest.mark.skipif(missing_for_a_disk() is not None, reason=str(missing_for_a_disk()))
@pytest.mark.parametrize(
    ("options", "words"), [(["--fsync"], "check the disk"), ([], "the file system is read-only")]
)
def test_the_ring_keeps_what_a_dead_disk_refuses(tmp_path, options, words):
    command = ["unshare", "-m", sys.executable, dying_disk.__file__, str(tmp_path), *options]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
    told = json.loads(done.stdout.splitlines()[-1])
    events, ring_events, dropped, error = told["closed"]
    assert told["exit_code"] == 0
    assert (events + ring_events, dropped) == (dying_disk.EVENTS, 0)
    assert ring_events > 0
    assert words in error
    left = tmp_path / "left" / "a.mcap"
    assert read_trace(left).events[Stage.T1].sequence.tolist() == list(range(dying_disk.EVENTS))
    recover(left)
    assert read_trace(left).events[Stage.T1].sequence.tolist() == list(range(dying_disk.EVENTS))

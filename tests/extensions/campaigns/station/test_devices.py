"""Relays on another device: through a real `ssh` to an `sshd` on loopback, and by printed commands."""

import os
import stat

import loopback_sshd
import pytest
from waiting import wait_until

from dds_trace.base.errors import BackendUnavailableError, OptionError
from dds_trace.base.version import __version__
from dds_trace.extensions.campaigns.plan.plan import DeviceSettings
from dds_trace.extensions.campaigns.station import programs, ssh
from dds_trace.extensions.campaigns.station.devices import LocalDevice, PrintedDevice
from dds_trace.extensions.campaigns.station.ssh import SshDevice

# Instead of the two programs of the other device, so that these tests need no middleware there.
RECORD = """#!/bin/sh
out=
while [ $# -gt 0 ]; do [ "$1" = --out ] && out=$2; shift; done
trap 'echo closed >>"$out"; exit 0' TERM
echo "dds-record: relay serves"
echo open >"$out"
while :; do sleep 0.05; done
"""
HALF = """#!/bin/sh
[ "$1" = --version ] && echo "dds-trace $VERSION" && exit
trap 'echo "half closed" >"$HOME/half"; exit 0' TERM
echo "$@" >"$HOME/half"
while :; do sleep 0.05; done
"""
BROKEN_RECORD = """#!/bin/sh
echo "dds-record: rmw_nowhere is not installed" >&2
exit 7
"""
SLOW_TO_TELL = '; echo() { sleep 2; printf "%s\\n" "$*"; }'
"""A shell that takes long to write down the id that is waited for."""


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    return loopback_sshd.sshd(tmp_path_factory.mktemp("sshd"))


@pytest.fixture
def remote(server, tmp_path):
    (tmp_path / "home").mkdir()
    (tmp_path / "bin").mkdir()
    (tmp_path / "parts").mkdir()

    def make(record=RECORD, version=__version__, destination=server.destination, shell=""):
        for name, text in (("dds-record", record), ("dds-trace", HALF.replace("$VERSION", version))):
            (tmp_path / "bin" / name).write_text(text)
            (tmp_path / "bin" / name).chmod(0o755)
        settings = DeviceSettings(
            ssh=destination,
            ssh_options=server.options,
            setup=f"HOME={tmp_path / 'home'}{shell}",
            path=str(tmp_path / "bin"),
        )
        return SshDevice(settings, tmp_path / "parts", "my sweep")

    return make


def there(tmp_path):
    return tmp_path / "home/.cache/dds-trace/my sweep"


def test_relay_is_started_and_stopped_over_ssh_and_its_trace_fetched(remote, tmp_path):
    device = remote()
    device.prepare()
    relay = device.start(["--role", "relay", "--label", "two words"], "1-1.mcap")
    wait_until((there(tmp_path) / "1-1.mcap").exists)
    assert relay.failure is None
    relay.stop()
    fetched = device.collect("1-1.mcap")
    assert fetched.read_text() == "open\nclosed\n"
    device.discard("1-1.mcap")
    assert list(there(tmp_path).iterdir()) == []
    assert list((tmp_path / "parts").iterdir()) == []


@pytest.mark.parametrize(("there", "here"), [("0600", 0o600), ("0640", 0o640), ("0666", 0o640), ("0000", 0o600)])
def test_fetched_trace_has_the_rights_that_it_has_on_its_device_and_none_for_others(remote, tmp_path, there, here):
    device = remote(RECORD.replace("exit 0' TERM", f'chmod {there} "$out"; exit 0\' TERM'))
    device.prepare()
    relay = device.start([], "1-1.mcap")
    wait_until((tmp_path / "home/.cache/dds-trace/my sweep/1-1.mcap").exists)
    relay.stop()
    if os.geteuid() != 0 and there == "0000":
        pytest.skip("who may not read a file cannot fetch it")
    before = os.umask(0)
    try:
        fetched = device.collect("1-1.mcap")
    finally:
        os.umask(before)
    assert stat.S_IMODE(fetched.stat().st_mode) == here


def test_half_of_a_bridge_runs_next_to_the_relay_of_the_other_device(remote, tmp_path):
    device = remote()
    device.prepare()
    relay = device.start([], "1-1.mcap")
    half = device.start_half(["zenoh-bridge-dds", "--half", "relay"], "1-1.mcap")
    said = tmp_path / "home/half"
    wait_until(lambda: said.exists() and said.read_text() == "bridge zenoh-bridge-dds --half relay\n")
    half.stop()
    relay.stop()
    assert said.read_text() == "half closed\n"
    device.discard("1-1.mcap")
    assert list(there(tmp_path).iterdir()) == []
    assert list((tmp_path / "parts").iterdir()) == []


@pytest.mark.parametrize("shell", ["", SLOW_TO_TELL], ids=["", "slow to tell"])
def test_relay_ends_when_this_side_is_killed_and_is_fetched_whole_later(remote, tmp_path, shell):
    device = remote(shell=shell)
    device.prepare()
    relay = device.start([], "1-1.mcap")
    wait_until((there(tmp_path) / "1-1.mcap").exists)
    relay._process.kill()
    relay.stop()
    assert device.collect("1-1.mcap").read_text() == "open\nclosed\n"


def test_ring_of_a_killed_relay_is_fetched_with_its_trace(remote, tmp_path):
    device = remote()
    device.prepare()
    for name in ("1-1.mcap", "1-1.mcap.ring"):
        (there(tmp_path) / name).write_text(name)
    assert device.collect("1-1.mcap") == tmp_path / "parts/1-1.mcap"
    assert (tmp_path / "parts/1-1.mcap.ring").read_text() == "1-1.mcap.ring"


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


HAS_EVERYTHING = "; test() { return 1; }; stat() { echo 4777; }"
"""A shell that claims to have every file that it is asked for, with all rights."""


def test_hostile_device_makes_no_names_and_writes_through_no_link(remote, tmp_path):
    evil = "; ls() { echo ../../evil; echo 1-1.mcap.sh; }; cat() { echo evil; }"
    device = remote(shell=HAS_EVERYTHING + evil)
    (tmp_path / "important").write_text("mine")
    (tmp_path / "parts/1-1.mcap").symlink_to(tmp_path / "important")
    assert device.collect("1-1.mcap") == tmp_path / "parts/1-1.mcap"
    assert names_in(tmp_path / "parts") == ["1-1.mcap", "1-1.mcap.ring"]
    assert (tmp_path / "important").read_text() == "mine"
    assert names_in(tmp_path) == ["bin", "home", "important", "parts"]


@pytest.mark.parametrize("endless", ["yes", "yes >&2"])
def test_endless_answer_of_a_device_is_cut_and_leaves_nothing(remote, tmp_path, monkeypatch, endless):
    monkeypatch.setattr(ssh, "MOST_TRACE_BYTES", 1 << 20)
    device = remote(shell=f"{HAS_EVERYTHING}; cat() {{ case $1 in *pid-*) ;; *) {endless} ;; esac; }}")
    with pytest.raises(BackendUnavailableError, match=r"sent more than [0-9,]+ bytes"):
        device.collect("1-1.mcap")
    assert list((tmp_path / "parts").iterdir()) == []


def test_device_that_never_ends_its_answer_is_given_up(remote, monkeypatch):
    monkeypatch.setattr(ssh, "SSH_TIMEOUT_S", 0.5)
    with pytest.raises(BackendUnavailableError, match=r"no end of its answer within 0\.5 s"):
        remote(shell="; dds-trace() { sleep 5; }").prepare()


def test_endless_log_of_a_device_ends_its_program(remote, monkeypatch):
    monkeypatch.setattr(programs, "MOST_LOG_BYTES", 1 << 20)
    device = remote(record="#!/bin/sh\nexec yes\n")
    device.prepare()
    relay = device.start([], "1-1.mcap")
    wait_until(lambda: relay.exit_code is not None)
    assert relay.log.stat().st_size <= 1 << 20
    relay.stop()


def test_host_that_looks_like_an_option_is_a_host(remote, tmp_path):
    device = remote(destination=f"-oProxyCommand=touch {tmp_path / 'pwned'}")
    with pytest.raises(BackendUnavailableError):
        device.prepare()
    assert not (tmp_path / "pwned").exists()


def test_leftovers_of_a_killed_sweep_are_removed_and_nothing_else(remote, tmp_path):
    device = remote()
    device.prepare()
    left = ["1-1-1.mcap", "1-1-1.mcap.ring", "1-1-2.mcap", "-rf.mcap"]
    kept = ["1-1-3.mcap", "1-1-3.mcap.ring", "notes.txt"]
    for name in (*left, *kept):
        (there(tmp_path) / name).write_text(name)
    (there(tmp_path) / "a folder.mcap").mkdir()
    (there(tmp_path) / "pid-1-1-1.mcap").write_text("999999999")
    device.clear(["1-1-3.mcap"])
    assert names_in(there(tmp_path)) == sorted([*kept, "a folder.mcap"])
    device.clear([])
    assert names_in(there(tmp_path)) == ["a folder.mcap", "notes.txt"]


def test_folder_there_is_of_this_sweep_alone_and_leads_nowhere_else(tmp_path):
    names = {ssh.folder_there(plan, tmp_path / at) for plan in ("plan", "../../bin") for at in "ab"}
    assert len(names) == 4
    assert not any("/" in name or name.startswith((".", "-")) for name in names)
    assert ssh.folder_there("plan", tmp_path) == ssh.folder_there("plan", tmp_path)


def test_local_device_removes_its_own_files_alone(tmp_path):
    for name in ("1-1-1.mcap", "1-1-1.mcap.ring", "1-1-1.mcap.log", "1-1-1.mcap.bak", "1-1-11.mcap"):
        (tmp_path / name).write_text("x")
    LocalDevice(tmp_path, []).discard("1-1-1.mcap")
    assert names_in(tmp_path) == ["1-1-1.mcap.bak", "1-1-11.mcap"]


def test_relay_that_fails_on_the_other_device_gives_its_reason(remote):
    device = remote(record=BROKEN_RECORD)
    device.prepare()
    relay = device.start([], "1-1.mcap")
    wait_until(lambda: relay.exit_code is not None)
    assert (relay.exit_code, relay.failure) == (7, "rmw_nowhere is not installed")
    relay.stop()
    assert device.collect("1-1.mcap") is None


@pytest.mark.parametrize("method", ["prepare", "check"])
def test_other_version_on_the_other_device_is_refused(remote, method):
    words = r"has dds-trace 0\.0\.9, this machine .*; install the same version on both"
    with pytest.raises(OptionError, match=words):
        getattr(remote(version="0.0.9"), method)()


def test_device_that_does_not_answer_is_named(remote):
    with pytest.raises(BackendUnavailableError, match=r"nobody@127\.0\.0\.1: .*try it by hand: ssh -- nobody@"):
        remote(destination="nobody@127.0.0.1").prepare()


def test_missing_program_on_the_other_device_is_a_clear_error(remote, tmp_path):
    device = remote()
    (tmp_path / "bin/dds-trace").unlink()
    device._setup = device._setup.replace("$PATH", "/bin:/usr/bin")
    with pytest.raises(BackendUnavailableError, match="dds-trace"):
        device.prepare()


def test_local_relay_writes_into_the_folder_and_leaves_nothing_when_discarded(tmp_path):
    script = tmp_path / "record"
    script.write_text(RECORD)
    device = LocalDevice(tmp_path / "parts", ["sh", str(script)])
    (tmp_path / "parts").mkdir()
    relay = device.start([], "1-1.mcap")
    wait_until((tmp_path / "parts/1-1.mcap").exists)
    relay.stop()
    assert device.collect("1-1.mcap").read_text() == "open\nclosed\n"
    device.discard("1-1.mcap")
    assert list((tmp_path / "parts").iterdir()) == []


def test_printed_relay_is_a_command_line_for_a_person(sentences):
    lines = []
    device = PrintedDevice(lines.append)
    device.start(["--role", "relay", "--device", "the robot"], "1-17-1.mcap").stop()
    device.start(["--role", "relay"], "2-17-1.mcap")
    device.start_half(["zenoh-bridge-dds", "--half", "relay"], "2-17-1.mcap")
    sentences(*lines)
    assert device.keeps_traces


CHECKED = """#!/bin/sh
echo "$@" >"$HOME/asked"
[ "$(for last; do :; done; echo "$last")" = --check ] || exit 1
case "$*" in *--tuned*) echo "dds-record: --tuned is not for this backend" >&2; exit 2;; esac
"""


def test_a_rehearsal_over_ssh_starts_the_relay_there_and_leaves_nothing(remote, tmp_path):
    device = remote(record=CHECKED)
    device.check()
    assert device.rehearse(["--role", "relay", "--label", "two words"]) is None
    asked = (tmp_path / "home/asked").read_text()
    *given, out, check = asked.split()
    assert (given, check) == (["--role", "relay", "--label", "two", "words", "--out"], "--check")
    assert out.startswith("dds-trace-rehearsal-")
    assert out.endswith(".mcap")
    assert not there(tmp_path).exists()
    assert list((tmp_path / "parts").iterdir()) == []


def test_a_rehearsal_over_ssh_gives_the_devices_own_reason(remote):
    reason = remote(record=CHECKED).rehearse(["--role", "relay", "--tuned"])
    assert "dds-record: --tuned is not" in reason


@pytest.mark.parametrize("text", ["<a>'1' $HOME</a>\n", "%s\\n\n"])
def test_a_configuration_is_sent_to_the_device_before_its_relay_starts(remote, tmp_path, text):
    record = RECORD.replace('[ "$1" = --out ]', '[ "$1" = --configuration ] && config=$2; [ "$1" = --out ]')
    device = remote(record.replace("echo open", 'cat "$config"'))
    device.prepare()
    mine = tmp_path / "it's mine.xml"
    mine.write_text(text)
    relay = device.start(["--role", "relay", "--configuration", str(mine)], "1-1.mcap")
    wait_until((there(tmp_path) / "1-1.mcap").exists)
    relay.stop()
    assert device.collect("1-1.mcap").read_text() == f"{text}closed\n"
    mine.unlink()
    with pytest.raises(OptionError, match=r"mine\.xml"):
        device.start(["--configuration", str(mine)], "1-2.mcap")

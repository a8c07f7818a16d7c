import os
import re

import pytest
import typer

from dds_trace.cli import analyze, trace
from dds_trace.cli.defaults import _WITHOUT_DEFAULT, FILE_NAME, VARIABLE, configurable, find_files, is_own_only
from dds_trace.cli.program import run_command
from dds_trace.cli.record import command as record
from dds_trace.extensions.bridges import command as bridge
from dds_trace.extensions.campaigns.commands import sweep
from dds_trace.extensions.campaigns.commands.dry_run import argument_check
from dds_trace.extensions.campaigns.station.devices import printed_command
from dds_trace.extensions.campaigns.station.programs import Program
from dds_trace.extensions.gates import command as compare
from dds_trace.extensions.live import command as watch

ROS = ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "RMW_IMPLEMENTATION")


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A home with a repository in it, in a folder of which we work; nothing of ROS is set."""
    (tmp_path / "repository/.git").mkdir(parents=True)
    (tmp_path / "repository/deep/er").mkdir(parents=True)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_CONFIG_HOME", raising=False)
    monkeypatch.delenv(VARIABLE)
    for name in ROS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path / "repository/deep/er")
    return tmp_path


@pytest.fixture
def run(monkeypatch, capsys):
    def call(app, *arguments):
        monkeypatch.setattr("sys.argv", ["dds-x", *arguments])
        with pytest.raises(SystemExit) as ended:
            run_command(app)
        said = capsys.readouterr()
        return ended.value.code or 0, said.out, said.err

    return call


@pytest.fixture
def in_force(run):
    def call(*arguments):
        code, out, err = run(record.app, "--print-config", *arguments)
        assert (code, err) == (0, "")
        return {name: (value, source) for name, value, source in (re.split(" {2,}", line) for line in out.splitlines())}

    return call


def write(folder, text):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / FILE_NAME).write_text(text)
    return folder / FILE_NAME


def test_the_nearest_file_counts_up_to_the_repository_and_then_the_users_own(home, monkeypatch):
    write(home, "")  # beyond the repository
    assert find_files() == []
    own = write(home / ".config/dds-trace", "")
    assert find_files() == [own]
    top = write(home / "repository", "")
    assert find_files() == [top, own]
    nearer = write(home / "repository/deep", "")
    assert find_files() == [nearer, own]
    monkeypatch.setenv("XDG_CONFIG_HOME", str(home / "elsewhere"))
    assert find_files() == [nearer]
    monkeypatch.setenv(VARIABLE, str(own))
    assert find_files() == [own]
    monkeypatch.setenv(VARIABLE, "")
    assert find_files() == []


@pytest.mark.usefixtures("home")
def test_outside_of_repository_and_home_only_the_working_directory_counts(tmp_path_factory, monkeypatch):
    outside = tmp_path_factory.mktemp("outside") / "a"
    write(outside.parent, "")
    outside.mkdir()
    monkeypatch.chdir(outside)
    assert find_files() == []
    here = write(outside, "")
    assert find_files() == [here]


def test_an_option_counts_before_ros_before_the_file_before_the_users_file_before_the_default(
    home, in_force, monkeypatch
):
    near = write(home / "repository", "[record]\nrate = 20\ndomain = 7\nsize = 33000\nlabel = 'site=lab'\n")
    own = write(home / ".config/dds-trace", "[record]\nrate = 5\ntuned = true\nrmw = 'rmw_x_cpp'\n")
    monkeypatch.setenv("RMW_IMPLEMENTATION", "rmw_y_cpp")
    said = in_force("--size", "1KB")
    assert said["--size"] == ("1KB", "option")
    assert said["--rmw"] == ("-", "environment: RMW_IMPLEMENTATION=rmw_y_cpp")
    assert said["--rate"] == ("20", str(near))
    assert said["--domain"] == ("7", str(near))
    assert said["-o label"] == ("site=lab", str(near))
    assert said["--tuned"] == ("true", str(own))
    assert said["--depth"] == ("10", "default")
    monkeypatch.setenv("ROS_DOMAIN_ID", "3")
    assert in_force()["--domain"] == ("-", "environment: ROS_DOMAIN_ID=3")
    # The domain of a ping behind a bridge is not that of the environment.
    assert in_force("--bridge", "builtin")["--domain"] == ("7", str(near))


def test_options_of_the_other_role_are_passed_over_and_the_rest_is_taken(home, run, monkeypatch):
    write(home / "repository", "[record]\nrate = 20\ndomain = 7\nreliability = 'best_effort'\nlabel = ['a=b', 'c=d']\n")
    taken = []
    monkeypatch.setattr("dds_trace.cli.record.run.record_until_stopped", lambda options, **_: taken.append(options))

    def take(role):
        run(lambda: trace.commands()[f"record {role}"]()(["--out", "x.mcap"]))
        return taken.pop()

    relay = take("relay")
    assert (relay.node.domain_id, relay.node.qos.reliability, relay.ping) == (7, "best_effort", None)
    ping = take("ping").ping
    assert (ping.rate_hz, ping.labels) == (20.0, {"a": "b", "c": "d"})


def test_whose_defaults_are_in_force_is_said(home, run):
    path = write(home / "repository", "[analyze]\nsketch = true\n[record]\nrate = 3\n")
    code, _, err = run(analyze.app, "nowhere")
    assert code != 0
    assert err.splitlines()[0].endswith(f": defaults of {path}: sketch")
    assert "defaults of" not in run(analyze.app, "nowhere", "--sketch")[2]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[record]\nraet = 1\n", "[record]: there is no 'raet'; did you mean 'rate'?"),
        ("[recrod]\nrate = 1\n", "there is no 'recrod'; did you mean 'record'?"),
        ("[record]\nmessages = 'many'\n", "[record]: messages: 'many' is not a valid int."),
        ("[record]\nreliability = 'most'\n", "[record]: reliability: 'most' is not one of"),
        ("[record]\nrate = [1, 2]\n", "[record]: rate is a list; write one value"),
        ("[record]\nforce = true\n", "[record]: force has no default; give --force each time"),
        ("[record]\ncheck = true\n", "give --check each time"),
        ("record = 1\n", "record is 1, not a table"),
        ("[record\n", "Expected"),
        ("\xff", "it is UTF-8 text"),
    ],
)
def test_what_cannot_be_a_default_is_one_line_with_its_file(home, run, text, said):
    path = home / "repository" / FILE_NAME
    path.write_bytes(text.encode("latin-1"))
    code, out, err = run(record.app, "--role", "ping", "--out", "x.mcap")
    assert (code, out) == (2, "")
    assert err.startswith(f"dds-x: {path}: ")
    assert said in err
    assert err.count("\n") == 1


# Free texts with a grammar of their own: none of them names code, an address, a file or what is sent.
DESCRIBING_TEXTS = {
    "record": "backend congestion-control connectivity cpu-affinity data deadline device fail-if-lost keep-free label lifespan "
    "rotate setting size topics expect flow response-size segment buffer rate fragment wait patience call-timeout duration",
    "bridge": "deadline lifespan",
    "sweep": "until fail-if",
    "analyze": "deadline fail-if margin export report figures",
    "compare": "fail-if ignore",
    "watch": "",
}
TABLES = {
    "record": record.app,
    "bridge": bridge.app,
    "sweep": sweep.app,
    "analyze": analyze.app,
    "compare": compare.app,
    "watch": watch.app,
}


@pytest.mark.parametrize("table", TABLES)
def test_each_option_with_a_free_value_is_the_users_own_or_describes_the_measurement(table):
    options = configurable(typer.main.get_command(TABLES[table]))
    free = {
        name
        for name, option in options.items()
        if not re.search("int|float|bool|choice", option.type.name + type(option.type).__name__, re.IGNORECASE)
    }
    own = {name for name, option in options.items() if is_own_only(option)}
    assert free - own - _WITHOUT_DEFAULT == set(DESCRIBING_TEXTS[table].split())


@pytest.mark.parametrize(
    ("table", "line"),
    [
        ("sweep", "against = 'evil'"),
        ("sweep", "out = '/tmp/x'"),
        ("analyze", "cluster = 'tcp://127.0.0.1:1'"),
        ("analyze", "out = '/tmp/x'"),
        ("analyze", "open = true"),
        ("compare", "out = '/tmp/x'"),
        ("watch", "host = '0.0.0.0'"),
        ("watch", "port = 1"),
        ("bridge", "listen = '0.0.0.0:1'"),
        ("bridge", "topic = ['/a:std_msgs/msg/String']"),
        ("record", "peer = ['192.0.2.1']"),
        ("record", "bridge = 'builtin'"),
        ("record", "bridge-peer = '192.0.2.1:1'"),
        ("record", "type = ['a/msg/B']"),
        ("record", "rmw = 'rmw_x_cpp'"),
        ("record", "data = 'file:/etc/passwd'"),
        ("record", "data = 'bag:x#/y'"),
        ("record", "data = 'topic:/camera'"),
        ("record", "out = 'x.mcap'"),
        ("record", "keep = 1"),
        ("record", "file-mode = '0666'"),
        ("record", "keys = 'k'"),
        ("record", "load-to = '192.0.2.1'"),
    ],
)
def test_a_working_folder_sets_no_program_address_or_output(home, run, table, line, monkeypatch):
    key = line.split(" ")[0]
    path = write(home / "repository", f"[{table}]\n{line}\n")
    code, out, err = run(TABLES[table], "x", "--print-config")
    assert (code, out) == (2, "")
    assert f"{path}: [{table}]: {key} = " in err
    assert "cannot come from a working folder" in err
    path.rename(write(home / ".config/dds-trace", ""))
    assert "working folder" not in run(TABLES[table], "x", "--print-config")[2]
    named = write(home / "elsewhere", f"[{table}]\n{line}\n")
    monkeypatch.setenv(VARIABLE, str(named))
    assert "working folder" not in run(TABLES[table], "x", "--print-config")[2]


def test_a_relative_configuration_folder_is_not_the_users(home, monkeypatch):
    monkeypatch.chdir(home / "repository")
    write(home / "repository/conf/dds-trace", "[sweep]\nagainst = 'evil'\n")
    monkeypatch.setenv("XDG_CONFIG_HOME", "conf")
    assert find_files() == []


def test_a_named_file_that_is_missing_and_one_of_a_stranger_are_refused(home, run, monkeypatch):
    path = write(home / "repository", "[record]\n")
    real = path.stat()
    monkeypatch.setattr("os.fstat", lambda _: os.stat_result((*real[:4], 4242, *real[5:])))
    code, _, err = run(record.app, "--role", "ping", "--out", "x.mcap")
    assert (code, "belongs to another user; remove it" in err) == (2, True)
    monkeypatch.undo()
    monkeypatch.setenv(VARIABLE, "/nonexistent.toml")
    code, _, err = run(record.app, "--role", "ping", "--out", "x.mcap")
    assert (code, "No such file or directory" in err) == (2, True)


def test_a_sweep_has_defaults_and_its_recordings_have_none(home, run, monkeypatch):
    write(home / ".config/dds-trace", "[record]\nreliability = 'best_effort'\n[sweep]\nout = 'there'\n")
    (home / "plan.toml").write_text("[run]\nmessages = 1\n")
    folders, checked = [], []

    def dry_run(_plan, out, *_rest, **_options):
        folders.append(str(out))
        return 0

    monkeypatch.setattr("dds_trace.extensions.campaigns.commands.dry_run.dry_run", dry_run)
    assert run(sweep.app, str(home / "plan.toml"), "--dry-run")[0] == 0
    assert folders == ["there"]
    assert VARIABLE not in os.environ
    monkeypatch.setattr("dds_trace.extensions.campaigns.commands.dry_run.check_options", checked.append)
    argument_check()(["--role", "relay", "--out", "x.mcap"])
    assert checked[0].node.qos.reliability == "reliable"
    program = Program(["env"], home / "env.log")
    assert program.wait(60) == 0
    assert f"{VARIABLE}=" in (home / "env.log").read_text().splitlines()
    assert printed_command(["--role", "relay"], 1).startswith(f"{VARIABLE}= dds-trace record relay ")

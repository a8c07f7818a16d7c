"""The page of `dds-trace studio`: strangers get nothing, and a person goes from the question to the saved settings."""

import http.client
import json
import math
import re
import shlex
import signal
import socket
import threading
from contextlib import ExitStack, contextmanager, suppress

import pytest
from browser import violations
from processes import running
from waiting import PATIENCE_S, wait_until

from dds_trace.base.errors import BackendUnavailableError, OutputError, TraceError
from dds_trace.extensions.campaigns.answer import answer
from dds_trace.extensions.campaigns.halving import Candidate, Event
from dds_trace.extensions.campaigns.studio.desk import Desk, question_of
from dds_trace.extensions.live.local_server import MOST_POSTED_BYTES, LocalServer

KEY = "a-key"
FORM = {
    "data": "binary",
    "size": "9KB",
    "rate": "20",
    "deadline": "50ms",
    "in_time": "99%",
    "minutes": "2",
    "host": "",
    "link": "",
}
FAST, SLOW = Candidate("Fast DDS (ROS 2)", "fastdds", "large", ()), Candidate("Zenoh", "zenoh", "", ())


def told(candidate, p50, p99, state="measured", lost=0, runs=1, text=""):
    return Event("look", text, candidate, state, runs, 40 * runs, lost, lost, p50, p99, 30.0)


ENDS = {
    11: OutputError("state.json: the disk is full; free space"),
    12: BackendUnavailableError("robot: no route to host"),
    13: TraceError("nothing can be recorded"),
}
"""What a search ends with, by the rate of its messages."""


class MadeSearch:
    """Tells of two candidates, and waits where a test wants to look."""

    def __init__(self, settings):
        self.going, self.settings, self.asked = threading.Event(), settings, []

    def __call__(self, question, _out, tell):
        self.asked.append(question)
        tell(Event("link", "measuring the link", left_s=110.0))
        tell(told(SLOW, None, None, "running", runs=0))
        for run in (1, 2):
            tell(told(SLOW, 9.0 * run, 80.0, runs=run))
            tell(told(FAST, 1.5, 2.5, runs=run))
        tell(told(SLOW, 18.0, math.inf, "dropped", lost=3, runs=2, text="Zenoh default gets no more runs: 3.8% lost"))
        self.going.wait()
        tell(told(FAST, 1.5, 2.5, runs=3))
        if ended := ENDS.get(question.plan.cells[0].rate):
            raise ended
        tell(Event("answer", "the sentence"))
        return {
            "sentence": "Use Fast DDS (ROS 2) large: 100.00% within 50 ms, p99 2.5 ms.",
            "recommended": {
                "configuration": str(self.settings),
                "exports": ["export RMW_IMPLEMENTATION=rmw_fastrtps_cpp"],
            },
            "proofs": [{"of": FAST.name, "against": SLOW.name, "verdict": "better", "reason": ""}],
        }


@pytest.fixture
def search(tmp_path):
    settings = tmp_path / "large.xml"
    settings.write_text("<dds/>")
    made = MadeSearch(settings)
    yield made
    made.going.set()


@pytest.fixture
def served(tmp_path, search):
    desk = Desk(tmp_path / "runs", search)
    threading.Thread(target=desk.work, daemon=True).start()
    server = LocalServer("127.0.0.1", 0, desk.answers, posts=desk.posts, key=KEY)
    with server.serving():
        yield server


def request(server, method, path, body=None, **headers):
    port = server.server_address[1]
    own = {"Host": f"127.0.0.1:{port}", "Cookie": f"dds-trace-{port}={KEY}", "Origin": f"http://127.0.0.1:{port}"}
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request(
        method, path, body, {name: value for name, value in {**own, **headers}.items() if value is not None}
    )
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text


def post(server, path, value, **headers):
    return request(server, "POST", path, json.dumps(value), **headers)


STRANGERS = {
    "no key": {"Cookie": None},
    "another key": {"Cookie": "dds-trace-1=a-key; other=1"},
    "another host": {"Host": "evil.example:80"},
    "no cookie at all": {"Cookie": "\x01;;=="},
}


@pytest.mark.parametrize("stranger", STRANGERS)
def test_a_stranger_reads_nothing_and_starts_nothing(served, search, stranger):
    for path in ("/", "/state", "/settings", "/machine", "/studio.js", "/?key=another"):
        status, text = request(served, "GET", path, **STRANGERS[stranger])
        assert status in (403, 421), path
        assert "Fast" not in text
    assert post(served, "/ask", FORM, **STRANGERS[stranger])[0] in (403, 421)
    assert search.asked == []


@pytest.mark.parametrize("origin", [None, "null", "http://evil.example", "http://localhost:1", "https://127.0.0.1"])
def test_a_page_of_another_origin_starts_and_stops_nothing(served, search, origin):
    assert post(served, "/ask", FORM, Origin=origin)[0] == 403
    assert post(served, "/stop", {}, Origin=origin)[0] == 403
    assert search.asked == []


def test_a_post_has_a_bound_and_a_form(served, search):
    assert request(served, "POST", "/ask", "x" * (MOST_POSTED_BYTES + 1))[0] == 413
    for body in ("", "[]", "{}", '{"rate": 20}', "[" * 10_000, json.dumps({**FORM, "rate": ["20"]})):
        status, text = request(served, "POST", "/ask", body)
        assert status == 200
        assert json.loads(text)["error"]
    assert search.asked == []


def test_400_connections_of_strangers_leave_the_page_served(served):
    with ExitStack() as stack:
        for _ in range(400):
            connection = stack.enter_context(socket.create_connection(served.server_address, timeout=60))
            connection.settimeout(60)

    def status():
        with suppress(http.client.HTTPException, OSError):
            return request(served, "GET", "/state")[0]

    wait_until(lambda: status() == 200)


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({"rate": ""}, "--rate"),
        ({"rate": "often"}, "--rate"),
        ({"size": "9 parsecs"}, "--size"),
        ({"size": ""}, "--size"),
        ({"deadline": "soon"}, "--deadline"),
        ({"in_time": "200%"}, "--in-time"),
        ({"minutes": "0"}, "--minutes"),
        ({"minutes": "nan"}, "--minutes"),
        ({"host": "../plan.toml"}, "--host"),
        ({"host": "robot.toml"}, "--host"),
        ({"link": "/etc/passwd"}, "--link"),
    ],
    ids=str,
)
def test_a_wrong_field_is_named(served, search, changed, word):
    status, text = post(served, "/ask", {**FORM, **changed})
    assert status == 200
    assert word in json.loads(text)["error"]
    assert search.asked == []


def test_the_command_line_asks_what_the_page_asked(served, search):
    assert json.loads(post(served, "/ask", FORM)[1]) == {"error": ""}
    wait_until(lambda: search.asked)
    words = shlex.split(json.loads(request(served, "GET", "/state")[1])["command"])
    assert words[:2] == ["dds-trace", "advise"]
    assert dict(zip(words[2::2], words[3::2], strict=True)) == {
        f"--{name.replace('_', '-')}": text for name, text in FORM.items() if text
    }
    assert search.asked[0].limits == question_of(FORM).limits


def test_a_second_question_waits_for_the_first_and_a_stop_ends_it(served, search):
    post(served, "/ask", FORM)
    assert "under way" in json.loads(post(served, "/ask", FORM)[1])["error"]
    post(served, "/stop", {})
    search.going.set()
    wait_until(lambda: not json.loads(request(served, "GET", "/state")[1])["running"])
    state = json.loads(request(served, "GET", "/state")[1])
    assert "Stopped" in state["note"]
    post(served, "/stop", {})
    assert json.loads(request(served, "GET", "/state")[1]) == state
    assert json.loads(post(served, "/ask", FORM)[1]) == {"error": ""}
    wait_until(lambda: json.loads(request(served, "GET", "/state")[1])["answer"])


@pytest.mark.parametrize("rate", ENDS)
def test_what_ends_a_search_is_said_with_what_was_measured_and_the_next_one_runs(served, search, rate):
    search.going.set()
    post(served, "/ask", {**FORM, "rate": str(rate)})
    wait_until(lambda: json.loads(request(served, "GET", "/state")[1]).get("error") == str(ENDS[rate]))
    state = json.loads(request(served, "GET", "/state")[1])
    assert (state["running"], state["note"], len(state["rows"])) == (False, "", 2)
    post(served, "/ask", FORM)
    wait_until(lambda: json.loads(request(served, "GET", "/state")[1])["answer"])


def test_a_stop_that_comes_with_the_answer_leaves_the_answer_and_what_can_be_saved_without_a_file(tmp_path):
    desk, found = Desk(tmp_path), {"sentence": "Use it.", "recommended": {"exports": ["export A=b", "export C=d"]}}

    def stopped(_question, _out, tell):
        desk.posts["/stop"](b"")
        tell(Event("answer", "Use it."))
        return found

    desk._search = stopped
    threading.Thread(target=desk.work, daemon=True).start()
    desk.posts["/ask"](json.dumps(FORM).encode())
    wait_until(lambda: not json.loads(desk.answers["/state"]()[1])["running"])
    state = json.loads(desk.answers["/state"]()[1])
    assert (state["note"], state["answer"]) == ("", found)
    assert desk.answers["/settings"]()[1] == b"export A=b\nexport C=d\n"


def test_earlier_answers_of_strangers_are_left_out(tmp_path):
    asked = {
        "messages": [{"data": "binary", "size": 9000, "rate_hz": 20.0}],
        "limits": {"deadline_ms": None},
        "minutes": 2,
        "host": None,
    }
    found = {"sentence": "Use it.", "question": asked, "link": None}
    for name, text in {
        "good": json.dumps(found),
        "nothing": "{}",
        "list": "[]",
        "nested": "[" * 100_000,
        "numbers": json.dumps({**found, "question": {**asked, "minutes": "1e999x"}}),
        "large": json.dumps({**found, "more": "x" * (2 << 20)}),
    }.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "answer.json").write_text(text)
    (tmp_path / "link").mkdir()
    (tmp_path / "link" / "answer.json").symlink_to("/dev/zero")
    (earlier,) = json.loads(Desk(tmp_path).answers["/state"]()[1])["earlier"]
    assert (earlier["name"], earlier["sentence"]) == ("good", "Use it.")
    assert question_of({**FORM, **earlier["form"]}).plan.cells == question_of(FORM).plan.cells


@contextmanager
def opened(server, tab, width):
    complaints = []
    tab.set_viewport_size({"width": width, "height": 900})
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    tab.goto(f"http://127.0.0.1:{server.server_address[1]}/?key={KEY}")
    yield tab
    assert complaints == []


def fits(tab):
    return tab.evaluate("document.documentElement.scrollWidth <= innerWidth")


@pytest.mark.browser
@pytest.mark.parametrize("width", [1280, 390])
def test_a_person_goes_from_the_question_to_the_settings_by_keyboard(served, search, new_tab, width):
    with opened(served, new_tab, width) as tab:
        assert "key" not in tab.url
        tab.locator("[name=size]").focus()
        for text in ("9KB", "20", "50ms"):
            tab.keyboard.type(text)
            tab.keyboard.press("Tab")
        tab.keyboard.press("Enter")
        rows = tab.locator("#candidates tbody tr")
        rows.nth(1).filter(has_text="3.8% lost").wait_for()
        names = [rows.nth(index).locator("th").inner_text().split("\n")[0].strip() for index in (0, 1)]
        assert names == [FAST.name, SLOW.name]
        assert rows.nth(1).locator("td").last.inner_text() == "lost"
        assert violations(tab, "document") == []
        assert fits(tab)
        search.going.set()
        tab.locator("#sentence").filter(has_text="Use Fast DDS").wait_for()
        with tab.expect_download() as download:
            tab.locator("#save").press("Enter")
        assert download.value.suggested_filename == "large.xml"
        assert violations(tab, "document") == []
        assert fits(tab)


@pytest.mark.browser
def test_a_closed_tab_ends_nothing_and_a_second_one_joins(served, search, new_tab):
    with opened(served, new_tab, 1280) as tab:
        post(served, "/ask", FORM)
        tab.locator("#candidates tbody tr").nth(1).wait_for()
        tab.goto("about:blank")
        search.going.set()
        tab.goto(f"http://127.0.0.1:{served.server_address[1]}/")
        tab.locator("#sentence").filter(has_text="Use Fast DDS").wait_for()
    assert len(search.asked) == 1


BACKGROUND = ("sh", "-c", 'trap "" INT; exec "$0" "$@"')
"""A shell without jobs starts `command &` in this way, and all that this starts has SIGINT ignored."""


@pytest.mark.parametrize(
    ("number", "prefix"), [(signal.SIGINT, ()), (signal.SIGINT, BACKGROUND), (signal.SIGTERM, BACKGROUND)]
)
def test_the_terminal_ends_it(tmp_path, number, prefix):
    """Cold: a library that is imported takes SIGINT for itself."""
    words = ("dds-trace", "studio", "--port", 0, "--out", tmp_path)
    with running(*words, environment={"COLD": "1"}, prefix=prefix) as studio:
        wait_until(lambda: studio.printed)
        assert studio.stop(number).status == 130


@pytest.mark.slow  # a search of two minutes
@pytest.mark.middleware
@pytest.mark.browser
def test_a_search_with_real_middlewares_is_shown_and_ends_with_the_terminal(tmp_path, new_tab):
    with running("dds-trace", "studio", "--port", 0, "--out", tmp_path / "runs", environment={"COLD": "1"}) as studio:
        address = re.search(r"http://\S+", wait_until(lambda: "".join(studio.printed)))[0]
        new_tab.goto(address)
        for name, text in {"size": "1KB", "rate": "50", "minutes": "2"}.items():
            new_tab.locator(f"[name={name}]").fill(text)
        new_tab.locator(".primary").click()
        new_tab.locator("#sentence").filter(has_text="Use ").wait_for(timeout=2 * PATIENCE_S * 1000)
        assert new_tab.locator("#candidates tbody tr").count() >= 2
        assert studio.stop(signal.SIGINT).status == 130
    assert list((tmp_path / "runs").glob("*/answer.json"))


def test_the_made_search_takes_what_the_real_one_takes():
    assert list(answer.__annotations__)[:3] == ["question", "out", "tell"]

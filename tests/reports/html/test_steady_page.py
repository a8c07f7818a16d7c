import shlex

import pytest
from four_campaigns import CAMPAIGNS

from dds_trace.analyzer.verdicts.job import make_job

pytestmark = pytest.mark.browser

# What plotly is told to draw before the page lets the browser paint; a part of a closed fold is not visible.
DRAWN = """async () => {
    const real = Plotly.react, drawn = [];
    Plotly.react = (row, ...rest) => { drawn.push(row); return real(row, ...rest); };
    change(() => { view.statistic = view.statistic === "p50" ? "p90" : "p50"; });
    Plotly.react = real;
    const seen = row => { const { top, bottom } = row.getBoundingClientRect(); return row.checkVisibility() && bottom > 0 && top < innerHeight; };
    const shown = drawn.map(seen), rows = [...document.querySelectorAll(".plot .row")].filter(seen).length;
    await new Promise(requestAnimationFrame);
    return [shown, rows];
}"""


def test_every_figure_is_as_high_as_its_room_on_a_phone(read_with, pages):
    one = read_with(viewport={"width": 390, "height": 900})
    one.open(pages("lossy machine"))
    rows, misfits, growth = one.draw_all_as_planned()
    assert rows > 5
    assert (misfits, growth) == ([], 0)


@pytest.mark.parametrize("name", ["study", "500 groups"])
def test_a_scale_changes_no_height(reader, pages, name):
    tab = reader.open(pages(name))
    heights = """scale => { view.scale = scale; return blocks.map(block => { block.spoil(); block.plan();
        return [block.name, block.rows.map(({layout}) => layout.height)]; }); }"""
    assert tab.evaluate(heights, "linear") == tab.evaluate(heights, "log")


@pytest.mark.parametrize("name", ["lossy machine", "500 groups"])
def test_a_change_draws_the_rows_in_sight_and_no_other(reader, pages, name):
    tab = reader.open(pages(name))
    tab.evaluate("for (const block of blocks) block.plan()")
    most = 0
    for place in range(0, tab.evaluate("document.documentElement.scrollHeight"), 1400):
        tab.evaluate(f"scrollTo(0, {place})")
        shown, rows = tab.evaluate(DRAWN)
        assert all(shown), place
        assert len(shown) == rows, place
        most = max(most, rows)
    assert 0 < most < tab.locator(".plot .row").count() / 3


@pytest.mark.parametrize("name", ["lossy machine", "500 groups", "hostile strings"])
def test_columns_are_at_once_as_wide_as_all_their_rows_need(reader, pages, name):
    tab = reader.open(pages(name))
    widths = "[...document.querySelectorAll('#groups-table thead th')].map(th => Math.round(th.getBoundingClientRect().width))"
    count = tab.evaluate("DATA.groups.count")
    first = tab.evaluate(f"(() => {{ document.querySelector('#all-columns').click(); return {widths}; }})()")
    tab.locator("#groups-table tbody tr").nth(count - 1).wait_for(state="attached")
    assert tab.evaluate(widths) == first
    assert len(first) > 10
    # As wide as without the room that is kept for what comes.
    tab.evaluate("for (const room of document.querySelectorAll('#groups-table .room')) room.remove()")
    assert all(abs(now - then) <= 3 for now, then in zip(tab.evaluate(widths), first, strict=True))
    assert reader.complaints == []


@pytest.mark.thorough
def test_the_buttons_of_a_figure_stay_where_they_are_whatever_its_note_says(reader, pages):
    tab = reader.open(pages("500 groups"))
    places = (
        "[...document.querySelectorAll('#figure-domain_difference .actions > :not(.note)')].map(one => one.offsetLeft)"
    )
    notes = "document.querySelector('#figure-domain_difference .note').textContent"
    tab.evaluate("change(() => { view.statistic = 'p90'; }); for (const block of blocks) block.plan()")
    noted = tab.evaluate(places)
    assert "is a lost message" in tab.evaluate(notes)
    tab.evaluate(f"{notes} = ''")
    assert tab.evaluate(places) == noted


def command_for(tab, **fields):
    for name, value in fields.items():
        field = tab.locator(f"#job-form [name={name}]")
        if field.evaluate("e => e.tagName") == "SELECT":
            field.select_option(value)
        else:
            field.fill(value)
    return shlex.split(tab.locator("#job-command code").text_content())


def job_of(command):
    options = command[3:]
    return make_job(**{name.lstrip("-"): value for name, value in zip(options[::2], options[1::2], strict=True)})


def test_every_choice_of_the_form_is_a_job_that_the_command_reads(reader, pages):
    tab = reader.open(pages("demo"))
    command = command_for(tab)
    assert command[:3] == ["dds-trace", "choose", CAMPAIGNS["demo"]().title]
    assert job_of(command).deadline_ns == 50_000_000
    for name in ("size", "rate"):
        for value in tab.locator(f"#job-{name} option").evaluate_all("all => all.map((one) => one.value)"):
            job_of(command_for(tab, **{name: value}))
    for name in ("data", "reliability", "domain"):
        for value in tab.locator(f"#job-form [name={name}] option").evaluate_all("all => all.map((one) => one.value)"):
            job_of(command_for(tab, **{name: value}))
    job = job_of(command_for(tab, size="12.5 KB", rate="7 Hz", deadline="3 ms", reliability="0.999", domain="same"))
    assert (job.payload_bytes, job.rate_hz, job.deadline_ns, job.reliability, job.domain_mode) == (
        12500,
        7.0,
        3_000_000,
        0.999,
        "same",
    )
    assert reader.complaints == []


def test_what_is_typed_stays_one_word(reader, pages):
    tab = reader.open(pages("demo"))
    usual = command_for(tab)
    assert len(command_for(tab, size='1"; reboot; $(ls) `id` \\')) == len(usual)

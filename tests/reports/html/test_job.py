import shlex

import pytest
from four_campaigns import CAMPAIGNS

from dds_trace.analyzer.verdicts.job import parse_job

pytestmark = [pytest.mark.browser, pytest.mark.timeout(300)]


def command_for(tab, **fields):
    for name, value in fields.items():
        field = tab.locator(f"#job-form [name={name}]")
        if field.evaluate("e => e.tagName") == "SELECT":
            field.select_option(value)
        else:
            field.fill(value)
    return shlex.split(tab.locator("#job-command code").text_content())


def test_every_choice_of_the_form_is_a_job_that_the_command_reads(reader, pages):
    tab = reader.open(pages("demo"))
    program, folder, option, job = command_for(tab)
    assert (program, folder, option) == ("dds-analyze", CAMPAIGNS["demo"]().title, "--recommend")
    assert parse_job(job).deadline_ns == 50_000_000
    for name in ("size", "rate"):
        for value in tab.locator(f"#job-{name} option").evaluate_all("all => all.map((one) => one.value)"):
            parse_job(command_for(tab, **{name: value})[-1])
    for name in ("data", "reliability", "domain"):
        for value in tab.locator(f"#job-form [name={name}] option").evaluate_all("all => all.map((one) => one.value)"):
            parse_job(command_for(tab, **{name: value})[-1])
    job = parse_job(
        command_for(tab, size="12.5 KB", rate="7 Hz", deadline="3 ms", reliability="0.999", domain="same")[-1]
    )
    assert (job.payload_bytes, job.rate_hz, job.deadline_ns, job.reliability, job.domain_mode) == (
        12500,
        7.0,
        3_000_000,
        0.999,
        "same",
    )
    assert reader.complaints == []


def test_what_is_typed_stays_one_argument(reader, pages):
    tab = reader.open(pages("demo"))
    assert len(command_for(tab, size='1"; reboot; $(ls) `id` \\')) == 4

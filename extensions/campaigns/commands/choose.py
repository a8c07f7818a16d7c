"""`dds-trace choose runs/`: the measured setups for a message, a rate and a deadline, best first."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Annotated

from dds_trace.base.streams import say
from dds_trace.base.units import spell_size
from dds_trace.cli.outputs import Opens, Out, Paths, Reports, ShowsAll
from dds_trace.cli.program import command, make_app, option

MOST_KINDS = 12

app = make_app()


@command(app, "choose", often=("size", "rate", "deadline", "reliability", "data", "report", "out", "open_it"))
def choose_command(
    paths: Paths,
    size: Annotated[str, option("--size SIZE", "Size of a message: 33KB, 4MB.")],
    rate: Annotated[str, option("--rate HZ", "Messages a second.")],
    deadline: Annotated[str, option("--deadline TIME", "Time within which a reply must come, e.g. 50ms.")],
    reliability: Annotated[
        str, option("--reliability SHARE", "Share of the messages that must come in time.", show_default=True)
    ] = "0.99",
    data: Annotated[
        str, option("--data KIND", "Data of the messages: binary, string, imu.", show_default=True)
    ] = "binary",
    domain: Annotated[
        str | None, option("--domain MODE", "same or different: only setups of one domain, or of two. Default: both")
    ] = None,
    metric: Annotated[
        str,
        option(
            "--metric NAME",
            "What the deadline is for: response (planned send to reply), or another.",
            show_default=True,
        ),
    ] = "response",
    report: Reports = None,
    shows_all: ShowsAll = False,
    out: Out = None,
    open_it: Opens = False,
) -> None:
    """Rank the measured setups for a size, a rate and a deadline.

    For example:

        dds-trace choose runs/ --size 502KB --rate 20 --deadline 50ms

    What was measured is kept in $XDG_STATE_HOME/dds-trace/learned, for other sizes, rates and links.
    """
    from dds_trace.analyzer.verdicts.cases import MOST_COMPARED_ROWS
    from dds_trace.analyzer.verdicts.job import make_job
    from dds_trace.cli.analysis import run_analysis

    from ..learning.results import campaign_of, keep

    job = make_job(
        size=size, rate=rate, deadline=deadline, reliability=reliability, data=data, domain=domain, metric=metric
    )
    analysis = run_analysis(paths, out, report, {"job": job}, open_it=open_it, shows_all=shows_all)
    recommendation = analysis.details.recommendation
    candidates = () if recommendation is None else recommendation.candidates
    if not any(candidate.measured for candidate in candidates):
        kinds = analysis.summary.select("data_type", "payload_bytes", "rate_hz").unique(maintain_order=True)
        shown = [f"{data} {spell_size(size)} at {rate:g} Hz" for data, size, rate in kinds.head(MOST_KINDS).iter_rows()]
        say(f"measured: {', '.join(shown)}{' ...' if kinds.height > MOST_KINDS else ''}")
    if not all(candidate.measured for candidate in candidates) and find_spec("sklearn") is None:
        say(
            "pip install 'dds-trace[learn]' (in a clone '.[learn]'): then what nobody measured is estimated from what was"
        )
    if analysis.summary["published"].sum() <= MOST_COMPARED_ROWS:  # in memory once more
        say(keep(campaign_of(analysis.load_messages(), job)))

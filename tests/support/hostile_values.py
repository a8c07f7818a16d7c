"""Values that nobody means, as text of a command line and as values of TOML and JSON, and commands run on them."""

import contextlib
import io
import json
import re
import sys
from functools import partial
from pathlib import Path

from hypothesis import strategies as st

from dds_trace.cli import analyze, trace
from dds_trace.cli.program import run_command
from dds_trace.cli.record import command as record

COMMANDS = {
    "dds-record": record.app,
    "dds-analyze": analyze.app,
    **{
        f"dds-trace {name}": trace.commands()[name]()
        for name in trace.commands()
        if not name.startswith(("record ", "analyze"))
    },
}
"""Every command -> its app; `dds-record` and `dds-analyze` have the options of what is left out."""

_EXIT_CODES = (Path(__file__).parents[2] / "docs" / "reference" / "exit-codes.md").read_text()
EXIT_CODES = {0, 10, 11, 130, 20, 21, 22} | {
    int(code) for code in re.findall(r"^\| (\d+) \|", _EXIT_CODES, re.MULTILINE)
}
"""Exit codes that docs/reference/exit-codes.md names; those of gates and sweeps are in its text."""

HOSTILE_TEXTS = [
    *("", " ", "-1", "0", "1", "nan", "inf", "-inf", "1e12", "1e300", "1e-300", "268435456", "1GB", "3GB"),
    *("9" * 30, "1" + "0" * 400, "1" + "0" * 5000, "0-99999999999", "\u0661", "\u00b2", "a:\u00b2", "::1", "a b:1"),
    *("file:", "bag:", "bag:#", "topic:", "topic:/", "topic:a b", "topic:/\u00e9", "topic:" + "x" * 300),
    *("\udcff", "a=\udcff", "\udcff=a", "\ud800", "a=b", "=", "\n", "\x1b[2J", '"\n:1', "../x", "x" * 300, "x" * 5000),
    *("nan%", "1%", "20ms", "20ms metric=\udcff", "latency_p99:nan%", "latency_p99:5%", "latency_p99 > +nan%"),
    *("data=binary size=1 rate=nan deadline=1ms", "gopher://x", "tcp://\udcff:1", "SAME", "p.toml"),
]

HOSTILE_NUMBERS = [
    *(-1, 0, 1, 2**31, 2**32, 2**63, 2**64, 10**12, 10**19, 10**400, -(10**400)),
    *(-1.0, 0.0, -0.0, 0.5, 1e-300, 1e300, float("nan"), float("inf"), float("-inf")),
]


def texts() -> st.SearchStrategy[str]:
    """Texts that can stand on a command line: no NUL, any surrogate that an undecodable byte leaves."""
    drawn = st.text(
        st.characters(exclude_characters="\0", exclude_categories=("Cs",)) | st.sampled_from("\udc80\udcff"),
        max_size=40,
    )
    numbers = st.integers().map(str) | st.floats().map(str)
    held = [text for text in HOSTILE_TEXTS if not re.search("[\ud800-\udc7f]", text)]
    return st.sampled_from(held) | drawn | numbers


def toml_values() -> st.SearchStrategy[object]:
    drawn = st.text(st.characters(exclude_categories=("Cs",)), max_size=40)
    held = st.sampled_from([text for text in HOSTILE_TEXTS if not re.search("[\ud800-\udfff]", text)])
    one = st.sampled_from(HOSTILE_NUMBERS) | held | drawn | st.integers() | st.floats() | st.booleans()
    return one | st.lists(one, max_size=3) | st.just({}) | st.just([[]])


def json_values() -> st.SearchStrategy[object]:
    """Values of JSON as Python reads and writes it: NaN, infinities and lone surrogates too."""
    one = st.sampled_from([*HOSTILE_NUMBERS, *HOSTILE_TEXTS]) | st.integers() | st.floats() | st.text(max_size=20)
    return one | st.none() | st.booleans() | st.lists(one, max_size=2) | st.dictionaries(st.just("\udcff"), one)


def to_toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return long_decimal(value)
    if isinstance(value, float):
        return str(value)
    if isinstance(value, list):
        return f"[{', '.join(map(to_toml, value))}]"
    return "{}" if isinstance(value, dict) else json.dumps(str(value), ensure_ascii=False).replace("\x7f", "\\u007f")


def long_decimal(value: int) -> str:
    """Return the digits of an integer, also of one that is too long for `str`."""
    return f"{'-' * (value < 0)}1{'0' * 400}" if abs(value) == 10**400 else str(value)


def run(command: str, arguments: list[str]) -> tuple[int, str, str]:
    """Run a command in this process; its exit code, stdout and stderr. Any other exception than its exit passes."""
    out, err = io.StringIO(), io.StringIO()
    program, before = command.split(maxsplit=1)[0], sys.argv
    sys.argv = [program, *arguments]
    code: object = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            run_command(partial(COMMANDS[command], arguments, prog_name=command))
    except SystemExit as ended:
        code = ended.code
    finally:
        sys.argv = before
    return int(code or 0), out.getvalue(), err.getvalue()  # type: ignore[call-overload]


def check_told(command: str, code: int, err: str) -> list[str]:
    """Return the line that says why a command failed; assert that there is one and a documented exit code, or that it ended well."""
    assert code in EXIT_CODES, (code, err)
    assert "Traceback" not in err
    reasons = [line for line in err.splitlines() if line.startswith(("Error: ", f"{command.split(maxsplit=1)[0]}: "))]
    assert code in (0, 10, 20, 21, 22) or len(reasons) == 1, err
    return [reason.encode(errors="backslashreplace").decode() for reason in reasons]

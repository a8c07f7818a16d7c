"""The readers of scripts/readers.py that are installed here read every number of our outputs; `just readers` tries the newest."""

import sys
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "scripts"))
import readers  # noqa: E402

PARQUET = "`roundtrips.parquet`, `summary.parquet`"
NOT_EXACT = {("`.csv`", "duckdb"), (PARQUET, "duckdb"), (PARQUET, "fastparquet")}
"""As the page says: microseconds (of Parquet before DuckDB 2), and wide steps."""


@pytest.fixture(scope="module")
def outputs(tmp_path_factory):
    """Outputs of two boots, and of losses with ids beyond 2^63 and percentiles that are not known."""
    folder = tmp_path_factory.mktemp("readers")
    readers.kept_campaign("emulated-link", folder, "ros2_same_binary-145KB_10Hz.*")
    boots = readers.kept_campaign("flows", folder, "cyclonedds_same_imu_100Hz_imu_with-camera.*")
    sources = (boots, ROOT / "sample_traces/losses", ROOT / "sample_traces/same_domain")
    return [readers.make_outputs(traces, folder / str(number)) for number, traces in enumerate(sources)]


@pytest.mark.thorough
@pytest.mark.parametrize(
    "reader", [pytest.param(each, id=f"{each.output}-{each.package}") for each in readers.READERS if each.package != "hdr-histogram-js"]
)  # fmt: skip
def test_every_number_is_read_right(outputs, reader):
    try:
        assert readers.version_of(reader.package, outputs[0])
    except metadata.PackageNotFoundError:
        pytest.skip(f"{reader.package} is not here")
    counts = [readers.compare(reader, folder) for folder in outputs]
    assert all(values for values, _ in counts)
    if (reader.output, reader.package) not in NOT_EXACT:
        assert [wrong for _, wrong in counts] == [0] * len(counts)


@pytest.mark.parametrize(
    ("want", "got", "most", "count"),
    [
        ([1, 2**63 + 1, None], [1, 2**63 + 1, float("nan")], 0.0, 0),
        ([1, 2**63 + 1, None], [1, float(2**63), 0], 0.0, 1),
        ([1.5, True, "a"], ["1.5", "true", b"a"], 0.0, 0),
        ([1000.0], [1001.0], 1e-3, 0),
        ([1, 2], [1], 0.0, 2),
    ],
)
def test_a_wrong_number_is_counted(want, got, most, count):
    assert readers.differing(want, got, most) == count

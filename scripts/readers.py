"""What other programs read in our outputs: every number of sample traces and kept campaigns, by the readers of each format.

`just readers` installs the newest releases in an environment of their own and writes the table of docs/reference/readers.md. The
tests run those readers that their environment has, in its versions.

    readers.py               # make outputs, install readers, compare, write the table
    readers.py read FOLDER   # in the other environment: compare the outputs in the folder, one JSON line for each reader
"""

# ruff: noqa: PLC0415 - each reader is imported at use, in an environment that has it

import csv
import json
import math
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/reference/readers.md"
MARKS = ("<!-- readers -->", "<!-- /readers -->")

Values = Sequence[Any]
Compared = tuple[Values, Values, float]
"""Values as they are, as they were read, and the largest relative difference that the format allows."""


class Reader(NamedTuple):
    output: str
    package: str
    read: Callable[[Path, Mapping[str, Any]], Iterator[Compared]]


# What a reader gives as plain values.


def plain(value: Any) -> Any:
    if isinstance(value, bytes):
        value = value.decode()
    if hasattr(value, "item"):
        value = value.item()
    return None if value == "" or (isinstance(value, float) and math.isnan(value)) else value


def is_same(want: Any, got: Any, most: float) -> bool:
    want, got = plain(want), plain(got)
    if isinstance(want, bool) and isinstance(got, str):
        return str(want).lower() == got
    if isinstance(want, (int, float)) and isinstance(got, str):
        got = type(want)(got)
    if isinstance(want, (int, float)) and isinstance(got, (int, float)):
        return want == got or abs(want - got) <= most * abs(want)
    return bool(want == got)


def differing(want: Values, got: Values, most: float) -> int:
    if len(want) != len(got):
        return max(len(want), len(got))
    return sum(not is_same(a, b, most) for a, b in zip(want, got, strict=True))


def columns_of(truth: Mapping[str, Any], name: str, read: Callable[[str], Values]) -> Iterator[Compared]:
    """Compare a table column by column; `read` returns one."""
    for column, values in truth[name].items():
        yield values, read(column), 0.0


def tables(pattern: str) -> Callable[[Callable[[Path], Callable[[str], Values]]], Callable[..., Iterator[Compared]]]:
    def of_reader(open_table: Callable[[Path], Callable[[str], Values]]) -> Callable[..., Iterator[Compared]]:
        def read(folder: Path, truth: Mapping[str, Any]) -> Iterator[Compared]:
            for name in ("roundtrips", "summary"):
                yield from columns_of(truth, name, open_table(folder / pattern.format(name)))

        return read

    return of_reader


# Tables


def arrow_column(table: Any) -> Callable[[str], Values]:
    import pyarrow as pa

    def column(name: str) -> Values:
        values = table[name]
        values = values.cast(pa.int64()) if pa.types.is_timestamp(values.type) else values
        return list(values.to_pylist())

    return column


def pandas_column(frame: Any) -> Callable[[str], Values]:
    def column(name: str) -> Values:
        values = frame[name]
        if str(values.dtype).startswith("datetime64"):
            utc = values.dt.tz_convert(None) if values.dt.tz else values
            return [None if is_null else ns for ns, is_null in zip(utc.astype("datetime64[ns]").astype("int64"), values.isna(), strict=True)]  # fmt: skip
        return [None if is_null else value for value, is_null in zip(values.tolist(), values.isna(), strict=True)]

    return column


def polars_column(frame: Any) -> Callable[[str], Values]:
    def column(name: str) -> Values:
        values = frame[name]
        return list((values.to_physical() if values.dtype.is_temporal() else values).to_list())

    return column


def duckdb_column(source: str) -> Callable[[str], Values]:
    import duckdb

    base = duckdb.connect()
    types = {name: kind for name, kind, *_ in base.execute(f"DESCRIBE SELECT * FROM {source}").fetchall()}  # noqa: S608
    values = (f"epoch_ns({name})" if kind.startswith("TIME") else f'"{name}"' for name, kind in types.items())
    rows = base.execute(f"SELECT {', '.join(values)} FROM {source}").fetchall()  # noqa: S608
    columns = dict(zip(types, zip(*rows, strict=True), strict=True))
    return lambda name: list(columns[name])


@tables("{}.parquet")
def parquet_pyarrow(path: Path) -> Callable[[str], Values]:
    import pyarrow.parquet as pq

    return arrow_column(pq.read_table(path))


@tables("{}.parquet")
def parquet_pandas(path: Path) -> Callable[[str], Values]:
    import pandas as pd

    return pandas_column(pd.read_parquet(path, engine="pyarrow"))


@tables("{}.parquet")
def parquet_fastparquet(path: Path) -> Callable[[str], Values]:
    import fastparquet

    return pandas_column(fastparquet.ParquetFile(str(path)).to_pandas())


@tables("{}.parquet")
def parquet_polars(path: Path) -> Callable[[str], Values]:
    import polars as pl

    return polars_column(pl.read_parquet(path))


@tables("{}.parquet")
def parquet_duckdb(path: Path) -> Callable[[str], Values]:
    return duckdb_column(f"read_parquet('{path}')")


@tables("{}.arrow")
def arrow_pyarrow(path: Path) -> Callable[[str], Values]:
    import pyarrow as pa

    with pa.OSFile(str(path)) as file:
        return arrow_column(pa.ipc.open_file(file).read_all())


@tables("{}.arrow")
def arrow_polars(path: Path) -> Callable[[str], Values]:
    import polars as pl

    return polars_column(pl.read_ipc(path))


def csv_table(open_table: Callable[[Path], Callable[[str], Values]]) -> Callable[..., Iterator[Compared]]:
    """Run ids are 16 hex digits, and instants, if they come as texts, ISO 8601."""

    def read(folder: Path, truth: Mapping[str, Any]) -> Iterator[Compared]:
        for name in ("roundtrips", "summary"):
            column_of = open_table(folder / f"{name}.csv")
            for column, values in truth[name].items():
                want = [f"{value:016x}" for value in values] if column == "run_id" else values
                got = [utc_ns(value) if column.endswith("_utc") else value for value in column_of(column)]
                yield want, got, 0.0

    return read


def utc_ns(value: Any) -> Any:
    found = re.fullmatch(r"(\d{4}-\d\d-\d\d)T(\d\d):(\d\d):(\d\d)\.(\d{9})Z", value) if isinstance(value, str) else None
    if not found:
        return value
    from datetime import date

    days = date.fromisoformat(found[1]).toordinal() - date(1970, 1, 1).toordinal()
    return (((days * 24 + int(found[2])) * 60 + int(found[3])) * 60 + int(found[4])) * 10**9 + int(found[5])


@csv_table
def csv_python(path: Path) -> Callable[[str], Values]:
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return lambda name: [row[name] for row in rows]


@csv_table
def csv_pyarrow(path: Path) -> Callable[[str], Values]:
    import pyarrow.csv

    return arrow_column(pyarrow.csv.read_csv(path))


@csv_table
def csv_pandas(path: Path) -> Callable[[str], Values]:
    import pandas as pd

    return pandas_column(pd.read_csv(path, keep_default_na=False, na_values=[""]))


@csv_table
def csv_polars(path: Path) -> Callable[[str], Values]:
    import polars as pl

    return polars_column(pl.read_csv(path, infer_schema_length=None))


@csv_table
def csv_duckdb(path: Path) -> Callable[[str], Values]:
    return duckdb_column(f"read_csv('{path}', sample_size=-1)")


# MCAP

FIELDS = ("latency", "rtt", "response", "intermediate", "outbound", "return", "clock_bound")


def derived(read: Callable[[Path], Iterator[tuple[str, int, Any]]]) -> Callable[..., Iterator[Compared]]:
    """Compare each message (topic, log time, fields by name) with its row."""

    def compare(folder: Path, truth: Mapping[str, Any]) -> Iterator[Compared]:
        rows = row_dicts(truth["roundtrips"])
        want = {(row["run_id"], row["relay_id"], row["sequence"]): row for row in rows}
        got = {}
        for topic, log_ns, fields in read(folder / "latency.derived.mcap"):
            run, relay = re.findall(r"(?:run|relay)_([0-9a-f]+)", topic)[-2:]
            got[int(run, 16), int(relay, 16), fields["sequence"]] = (log_ns, fields)
        yield sorted(want), sorted(got), 0.0
        for key in want.keys() & got.keys():
            row, (log_ns, fields) = want[key], got[key]
            times = [None if row[f"{name}_ns"] is None else row[f"{name}_ns"] / 1e6 for name in FIELDS]
            yield times, [fields[f"{name}_ms"] for name in FIELDS], 0.0
            yield [row["publish_utc"], row["payload_bytes"], row["outcome"] != "completed"], [log_ns, fields["payload_bytes"], bool(fields["lost"])], 0.0  # fmt: skip

    return compare


def recorded(read: Callable[[Path], Iterator[tuple[str, int, Any]]]) -> Callable[..., Iterator[Compared]]:
    """Compare the events T1 to T4 of the traces (topic, log time, fields by name) with the stamps of the rows."""
    stamps = {"t1": "publish_ns", "t2": "receive_ns", "t3": "relay_in_ns", "t4": "relay_out_ns"}

    def compare(_: Path, truth: Mapping[str, Any]) -> Iterator[Compared]:
        first: dict[tuple[Any, ...], int] = {}
        for path in truth["traces"]:
            for topic, _, fields in read(Path(path)):
                stage = topic.rpartition("/")[2]
                relay_id = 0 if stage == "t1" else fields["relay_id"]
                key = (stage, fields["run_id"], relay_id, fields["sequence"])
                first[key] = min(first.get(key, 1 << 63), fields["monotonic_ns"])
        rows = row_dicts(truth["roundtrips"])
        for stage, column in stamps.items():
            keys = [(stage, row["run_id"], 0 if stage == "t1" else row["relay_id"], row["sequence"]) for row in rows]
            yield [row[column] for row in rows], [first.get(key) for key in keys], 0.0

    return compare


def row_dicts(columns: Mapping[str, Values]) -> list[dict[str, Any]]:
    return [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]


def is_event(topic: str) -> bool:
    return topic.startswith("/latency/") or re.fullmatch(r"/dds_trace/t[1-4]", topic) is not None


def by_mcap(path: Path) -> Iterator[tuple[str, int, Any]]:
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        topics = [channel.topic for channel in reader.get_summary().channels.values() if is_event(channel.topic)]
        for _, channel, message, data in reader.iter_decoded_messages(topics) if topics else ():
            yield channel.topic, message.log_time, {name: getattr(data, name) for name in data.__slots__}


def by_rosbags(path: Path) -> Iterator[tuple[str, int, Any]]:
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        connections = [connection for connection in reader.connections if is_event(connection.topic)]
        for connection, log_ns, data in reader.messages(connections) if connections else ():
            yield connection.topic, log_ns, vars(reader.deserialize(data, connection.msgtype))


def by_pybag(path: Path) -> Iterator[tuple[str, int, Any]]:
    from dataclasses import asdict

    from pybag.mcap_reader import McapFileReader

    with McapFileReader.from_file(path) as reader:
        for topic in filter(is_event, reader.get_topics()):
            for message in reader.messages(topic):
                yield topic, message.log_time, asdict(message.data)


def by_rerun(path: Path) -> Iterator[tuple[str, int, Any]]:
    import pyarrow as pa
    from rerun.chunk import McapReader

    for chunk in McapReader(str(path)).stream():
        batch = chunk.to_record_batch()
        if not is_event(chunk.entity_path) or "message_log_time" not in batch.schema.names:
            continue
        log_ns = batch["message_log_time"].cast(pa.int64()).to_pylist()
        (name,) = (name for name in batch.schema.names if name.endswith(":message"))
        for at_ns, (fields,) in zip(log_ns, batch[name].to_pylist(), strict=True):
            yield chunk.entity_path, at_ns, {field: plain(value) for field, value in fields.items()}


# Figures of results


def openmetrics(folder: Path, truth: Mapping[str, Any]) -> Iterator[Compared]:
    """Find the result of each sample by its labels; quantiles and counts that a result has are all there."""
    from prometheus_client.openmetrics.parser import text_string_to_metric_families

    groups = row_dicts(truth["summary"])
    left = {(at, column) for at, row in enumerate(groups) for column in row if count_or_time(column) and row[column] is not None}  # fmt: skip
    families = text_string_to_metric_families((folder / "openmetrics.txt").read_text(encoding="utf-8"))
    for family in families:
        for sample in family.samples:
            labels = {name: value for name, value in sample.labels.items() if name != "quantile"}
            if "topic" in labels:
                continue
            (at,) = (n for n, row in enumerate(groups) if all(is_same(row[name], value, 1e-12) for name, value in labels.items()))  # fmt: skip
            name = family.name.removeprefix("dds_trace_")
            if "quantile" in sample.labels:
                share = f"{100 * float(sample.labels['quantile']):.12g}".replace(".", "_")
                column, scale = f"{name.removesuffix('_seconds')}_p{share}_ns", 1e9
            elif name.endswith("_messages"):
                column, scale = name.removesuffix("_messages"), 1
            else:
                continue
            yield [groups[at][column]], [sample.value * scale], 1e-12
            left.discard((at, column))
    yield [], sorted(left), 0.0


def count_or_time(column: str) -> bool:
    counts = ("published", "received", "duplicates", "reordered", "lost_outbound", "lost_in_relay", "lost_return", "lost_unknown")  # fmt: skip
    return column in counts or re.fullmatch(f"({'|'.join(METRICS)})_p[0-9_]+_ns", column) is not None


def histories(folder: Path, truth: Mapping[str, Any]) -> Iterator[Compared]:
    """Compare medians, p99 and shares received of all results, which the three files name by results."""
    benchmarks = json.loads((folder / "bencher.json").read_text(encoding="utf-8"))
    read: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for measures in benchmarks.values():
        for name, metric in measures.items():
            read["bencher"][name].append(metric["value"])
    for path in folder.glob("github-benchmark-*.json"):
        for entry in json.loads(path.read_text(encoding="utf-8")):
            scale = 100 if entry["unit"] == "%" else 1
            read["github"][entry["name"].rpartition(" ")[2]].append(entry["value"] / scale)
    with (folder / "otava.csv").open(newline="", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    for column, text in row.items():
        found = re.search("(latency_p50|latency_p99|received_ratio)(_[0-9a-f]{8})?$", column)
        if found and text:
            read["otava"][found[1]].append(float(text))
    for name, want in truth["measures"].items():
        for kind, most in (("bencher", 0.0), ("github", 1e-15), ("otava", 1e-5)):
            yield sorted(want), sorted(read[kind][name]), most


METRICS = ("rtt", "intermediate", "latency", "response")


def hdr_values(truth: Mapping[str, Any], read: Sequence[tuple[str, int, int, int]]) -> Iterator[Compared]:
    """Compare count, least and largest value of each result and metric, by three digits."""
    rows, columns = row_dicts(truth["roundtrips"]), truth["summary"].keys() & truth["roundtrips"].keys()
    keys = sorted(columns - {"duplicates", "reordered"})
    times: dict[Any, list[int]] = defaultdict(list)
    for row in rows:
        for metric in METRICS:
            if row[f"{metric}_ns"] is not None:
                times[(metric, *(row[key] for key in keys))].append(row[f"{metric}_ns"])
    want = [(metric, len(values), min(values), max(values)) for (metric, *_), values in times.items()]
    tags = re.compile(f"_({'|'.join(METRICS)})$")
    got = [(found[1], *rest) for tag, *rest in read if (found := tags.search(tag))]
    for column in (2, 3):
        orders = [sorted((one[0], one[1], one[column]) for one in side) for side in (want, got)]
        for index in range(3):
            yield *([one[index] for one in order] for order in orders), 2e-3


def hdr_python(folder: Path, truth: Mapping[str, Any]) -> Iterator[Compared]:
    from hdrh.histogram import HdrHistogram
    from hdrh.log import HistogramLogReader

    reader, read = HistogramLogReader(str(folder / "latency.hlog"), HdrHistogram(1, 2**62, 3)), []
    while (one := reader.get_next_interval_histogram()) is not None:
        read.append((one.get_tag(), one.get_total_count(), one.get_min_value(), one.get_max_value()))
    reader.close()
    yield from hdr_values(truth, read)


HDR_JS = """
const hdr = require('hdr-histogram-js');
for (const line of require('fs').readFileSync(process.argv[2], 'utf8').split('\\n')) {
  if (!line.startsWith('Tag=')) continue;
  const parts = line.split(','), one = hdr.decodeFromCompressedBase64(parts[4], 64);
  console.log(JSON.stringify([parts[0].slice(4), one.totalCount, one.minNonZeroValue, one.maxValue]));
}
"""


def hdr_javascript(folder: Path, truth: Mapping[str, Any]) -> Iterator[Compared]:
    script = folder.parent / "hdr.js"
    script.write_text(HDR_JS)
    done = subprocess.run(["node", script, folder / "latency.hlog"], capture_output=True, text=True, check=True)
    yield from hdr_values(truth, [json.loads(line) for line in done.stdout.splitlines()])


def validator(refuses: Callable[[Any, Any], bool]) -> Callable[..., Iterator[Compared]]:
    def read(folder: Path, truth: Mapping[str, Any]) -> Iterator[Compared]:
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
        damaged = report | {"groups": [{**report["groups"][0], "published": "many"}, *report["groups"][1:]]}
        yield [False, True], [refuses(truth["schema"], report), refuses(truth["schema"], damaged)], 0.0

    return read


@validator
def by_jsonschema(schema: Any, document: Any) -> bool:
    import jsonschema

    return not jsonschema.Draft202012Validator(schema).is_valid(document)


@validator
def by_jsonschema_rs(schema: Any, document: Any) -> bool:
    import jsonschema_rs

    return not jsonschema_rs.validator_for(schema).is_valid(document)


def perfetto(folder: Path, truth: Mapping[str, Any]) -> Iterator[Compared]:
    """Compare begin and length of each ping's slice with its row, and the ends of each arrow."""
    from perfetto.protos.perfetto.trace.perfetto_trace_pb2 import Trace, TrackEvent

    opened: dict[int, tuple[str, int]] = {}
    slices: dict[str, list[tuple[int, int]]] = defaultdict(list)
    flows: dict[int, list[str]] = defaultdict(list)
    for packet in Trace.FromString((folder / "timeline.pftrace").read_bytes()).packet:
        event = packet.track_event
        if event.type == TrackEvent.TYPE_SLICE_BEGIN:
            row = event.debug_annotations[0].string_value
            opened[event.track_uuid] = row, packet.timestamp
            flows[event.flow_ids[0]].append(row)
        elif event.type == TrackEvent.TYPE_SLICE_END:
            row, begin_ns = opened.pop(event.track_uuid)
            slices[row].append((begin_ns, packet.timestamp - begin_ns))
    rows = [row for row in row_dicts(truth["roundtrips"]) if row["outcome"] == "completed"]
    names = [f"{row['run_id']:016x} {row['relay_id']:08x} {row['sequence']}" for row in rows]
    yield (
        [row["rtt_ns"] for row in rows],
        [max((length for _, length in slices[name]), default=0) for name in names],
        0.0,
    )
    if len({row["ping_device"] for row in rows}) == 1:
        yield [row["publish_utc"] for row in rows], [min((begin for begin, _ in slices[name]), default=0) for name in names], 0.0  # fmt: skip
    yield [1] * len(flows), [len(set(ends)) for ends in flows.values()], 0.0


READERS = [
    *(
        Reader("`roundtrips.parquet`, `summary.parquet`", package, read)
        for package, read in (
            ("pyarrow", parquet_pyarrow),
            ("pandas", parquet_pandas),
            ("polars", parquet_polars),
            ("duckdb", parquet_duckdb),
            ("fastparquet", parquet_fastparquet),
        )
    ),
    *(Reader("`.arrow`", package, read) for package, read in (("pyarrow", arrow_pyarrow), ("polars", arrow_polars))),
    *(
        Reader("`.csv`", package, read)
        for package, read in (
            ("python", csv_python),
            ("pyarrow", csv_pyarrow),
            ("pandas", csv_pandas),
            ("polars", csv_polars),
            ("duckdb", csv_duckdb),
        )
    ),
    *(
        Reader(output, package, make(read))
        for output, make in (("`latency.derived.mcap`", derived), ("traces", recorded))
        for package, read in (
            ("mcap-ros2-support", by_mcap),
            ("rosbags", by_rosbags),
            ("pybag-sdk", by_pybag),
            ("rerun-sdk", by_rerun),
        )
    ),
    Reader("`bencher.json`, `github-benchmark-*.json`, `otava.csv`", "python", histories),
    Reader("`timeline.pftrace`", "perfetto", perfetto),
    Reader("`openmetrics.txt`", "prometheus-client", openmetrics),
    Reader("`latency.hlog`", "hdrhistogram", hdr_python),
    Reader("`latency.hlog`", "hdr-histogram-js", hdr_javascript),
    *(
        Reader("`report.json`", package, read)
        for package, read in (("jsonschema", by_jsonschema), ("jsonschema-rs", by_jsonschema_rs))
    ),
]


def version_of(package: str, folder: Path) -> str:
    if package == "python":
        return ".".join(map(str, sys.version_info[:3]))
    if package == "hdr-histogram-js":
        found = folder / "node_modules" / package / "package.json"
        return json.loads(found.read_text())["version"] if found.exists() else ""
    return version(package)


def compare(reader: Reader, folder: Path) -> tuple[int, int]:
    """Return how many values of the outputs in a folder a reader was compared in, and in how many it differs."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    values = wrong = 0
    for want, got, most in reader.read(folder, truth):
        values += max(len(want), len(got))
        wrong += differing(want, got, most)
    return values, wrong


# The outputs and what is true of them; only here our own code is used.

EXPORTS = ("csv", "arrow", "openmetrics", "hdr", "perfetto", "bencher", "github-benchmark", "otava")


def make_outputs(traces: Path, folder: Path) -> Path:
    """Analyze a folder of traces into a folder, and write what is true of the outputs next to them."""
    import polars as pl

    from dds_trace.analyzer.pipeline import analyze

    options = [*(word for kind in EXPORTS for word in ("--export", kind)), "--derived-mcap", "--report", "json"]
    command = [Path(sys.executable).with_name("dds-trace"), "analyze", traces, "--out", folder, *options]
    subprocess.run(command, check=True, capture_output=True)
    analysis = analyze(traces)  # in memory, from no file that a reader gets
    tables = {
        name: {column.name: (column.to_physical() if column.dtype.is_temporal() else column).to_list() for column in rows.cast({pl.Categorical: pl.String, pl.Enum: pl.String})}
        for name, rows in (("roundtrips", analysis.load_roundtrips()), ("summary", analysis.summary))
    }  # fmt: skip
    intervals = analysis.details.intervals.filter(pl.col("estimate_ns").is_finite(), metric="latency")
    measures = {
        f"latency_{name}": intervals.filter(percentile=name)["estimate_ns"].to_list() for name in ("p50", "p99")
    }
    measures["received_ratio"] = analysis.summary["received_ratio"].drop_nulls().to_list()
    schema = json.loads((ROOT / "reports/report.schema.json").read_text(encoding="utf-8"))
    truth = {
        **tables,
        "measures": measures,
        "traces": [str(path) for path in sorted(traces.rglob("*.mcap"))],
        "schema": schema,
    }
    (folder / "truth.json").write_text(json.dumps(truth), encoding="utf-8")
    return folder


def kept_campaign(name: str, folder: Path, pattern: str = "*") -> Path:
    with tarfile.open(ROOT / f"docs/results/{name}/traces.tar.xz") as archive:
        archive.extractall(folder / "all", filter="data")
    (folder / "in").mkdir(exist_ok=True)
    for number, path in enumerate(sorted((folder / "all").rglob(f"{pattern}.mcap"))):
        path.rename(folder / "in" / f"{number}-{path.name}")
    shutil.rmtree(folder / "all")
    return folder / "in"


def make_material(folder: Path) -> list[Path]:
    """Make the outputs of sample traces, two boots, ten relays, an emulated link with losses, and taps."""
    sources = [ROOT / "sample_traces" / name for name in ("same_domain", "different_domains", "losses")]
    sources += [kept_campaign(name, folder / name) for name in ("fan-out", "lossy-link", "two-clocks", "two-machines")]
    boots = folder / "boots"
    kept_campaign("emulated-link", boots, "ros2_same_binary-145KB_10Hz.*")
    sources.append(kept_campaign("flows", boots, "cyclonedds_same_imu_100Hz_imu_with-camera.*"))
    return [make_outputs(traces, folder / "outputs" / str(number)) for number, traces in enumerate(sources)]


def install_readers(folder: Path) -> Path:
    """Install the newest releases in an environment in the folder and return its Python."""
    python = folder / "venv/bin/python"
    packages = sorted({reader.package for reader in READERS} - {"python", "hdr-histogram-js"})
    subprocess.run(["uv", "venv", "--quiet", "--python", sys.executable, folder / "venv"], check=True)
    subprocess.run(["uv", "pip", "install", "--quiet", "--python", python, *packages], check=True)
    if shutil.which("npm"):
        outputs = folder / "outputs"
        subprocess.run(["npm", "install", "--silent", "--prefix", outputs, "hdr-histogram-js"], check=True)
    return python


def read_outputs(folder: Path) -> Iterator[dict[str, Any]]:
    for reader in READERS:
        found = version_of(reader.package, folder)
        if found:
            counts = [compare(reader, made.parent) for made in sorted(folder.glob("*/truth.json"))]
            values, wrong = map(sum, zip(*counts, strict=True))
            yield {"output": reader.output, "reader": f"{reader.package} {found}", "values": values, "wrong": wrong}


def table_of(rows: Sequence[Mapping[str, Any]]) -> str:
    readers: dict[str, list[str]] = defaultdict(list)
    for row in rows:
        wrong = f" **({row['wrong']:,} wrong)**" if row["wrong"] else ""
        readers[f"{row['output']} | {row['values']:,}"].append(f"{row['reader']}{wrong}")
    lines = ["| output | values | readers |", "|---|---|---|"]
    return "\n".join([*lines, *(f"| {start} | {', '.join(names)} |" for start, names in readers.items())])


def main() -> None:
    if sys.argv[1:2] == ["read"]:
        for row in read_outputs(Path(sys.argv[2])):
            print(json.dumps(row), flush=True)
        return
    with tempfile.TemporaryDirectory() as folder:
        make_material(Path(folder))
        python = install_readers(Path(folder))
        done = subprocess.run([python, __file__, "read", Path(folder) / "outputs"], check=True, stdout=subprocess.PIPE)
    table = table_of([json.loads(line) for line in done.stdout.splitlines()])
    print(table)
    page = PAGE.read_text(encoding="utf-8")
    start, end = (page.index(mark) for mark in MARKS)
    PAGE.write_text(f"{page[: start + len(MARKS[0])]}\n\n{table}\n\n{page[end:]}", encoding="utf-8")


if __name__ == "__main__":
    main()

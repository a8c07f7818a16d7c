"""OpenMetrics, HdrHistogram logs and Perfetto timelines, each read by a reader that is not ours."""

import csv
import io
import json
import math
import re
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import polars.selectors as cs
import pytest
from analyses import empty_folder, hostile, make_analysis, one_message, ping_without_relay
from otava import otava_alone
from tap_traces import FAR_NS, LAPTOP, ROBOT, Hearing, arrivals, camera, write_beacon, write_tap

from dds_trace.analyzer.exports.kinds import EXPORT_KINDS, export
from dds_trace.analyzer.pipeline import analyze
from dds_trace.extensions.exports.hdr_log import encode_histogram, hdr_log
from dds_trace.extensions.exports.history import bencher_json, github_benchmark_files, otava_csv
from dds_trace.extensions.exports.openmetrics import openmetrics_text
from dds_trace.extensions.exports.perfetto import timeline_slices, write_perfetto


@pytest.fixture(scope="module")
def with_topics(tmp_path_factory):
    folder = tmp_path_factory.mktemp("taps")
    published = camera(seconds=10)
    write_tap(folder / "robot.mcap", ROBOT, [Hearing(published, arrivals(published, 60_000))], session_id=1)
    far = arrivals(published, FAR_NS, lost=[7])
    write_tap(folder / "laptop.mcap", LAPTOP, [Hearing(published, far)], session_id=2)
    write_beacon(folder, LAPTOP, ROBOT, seconds=13)
    return analyze(folder)


def all_analyses(with_topics):
    return [with_topics, make_analysis(), empty_folder(), one_message(), ping_without_relay(), hostile()]


def test_openmetrics_is_read_by_the_parser_of_prometheus(with_topics):
    parser = pytest.importorskip("prometheus_client.openmetrics.parser")
    for analysis in all_analyses(with_topics):
        families = {family.name: family for family in parser.text_string_to_metric_families(openmetrics_text(analysis))}
        samples = families["dds_trace_latency_seconds"].samples
        medians = analysis.summary["latency_p50_ns"].drop_nulls().to_list()
        found = [one.value for one in samples if one.labels["quantile"] == "0.5"]
        assert found == pytest.approx([value / 1e9 for value in medians])
        counts = {
            name: sum(one.value for one in families[f"dds_trace_{name}_messages"].samples)
            for name in ("published", "received", "lost_outbound", "lost_in_relay", "lost_return", "lost_unknown")
        }
        for name, count in counts.items():
            of_topics = analysis.topics[name].sum() if name in analysis.topics.columns else 0
            assert count == analysis.summary[name].sum() + of_topics
        assert counts["published"] == sum(counts.values()) - counts["published"]


def test_openmetrics_of_a_topic(with_topics):
    parser = pytest.importorskip("prometheus_client.openmetrics.parser")
    families = {one.name: one for one in parser.text_string_to_metric_families(openmetrics_text(with_topics))}
    ages = {
        (one.labels["relay_device"], one.labels["quantile"]): one.value
        for one in families["dds_trace_age_seconds"].samples
    }
    (row,) = with_topics.topics.filter(relay_device="laptop").iter_rows(named=True)
    assert ages["laptop", "0.5"] == pytest.approx(row["age_p50_ns"] / 1e9)
    bounds = families["dds_trace_clock_error_bound_seconds"].samples
    assert max(one.value for one in bounds) == pytest.approx(row["bound_ns"] / 1e9)


@pytest.mark.parametrize("seed", range(5))
def test_a_histogram_is_read_by_hdrhistogram(seed):
    histogram = pytest.importorskip("hdrh.histogram").HdrHistogram
    import base64

    draw = np.random.default_rng(seed)
    values = np.unique(np.exp(draw.uniform(0, 25, 300)).astype(np.int64) * (draw.random(300) < 0.98))
    count = draw.integers(1, 10 ** draw.integers(1, 7), len(values))
    read = histogram.decode(base64.b64encode(encode_histogram(values, count)).decode())
    assert read.get_total_count() == count.sum()
    for share in (0.01, 0.5, 0.9, 0.99, 1.0):
        expected = values[np.searchsorted(np.cumsum(count), math.ceil(share * count.sum()))]
        assert read.get_value_at_percentile(100 * share) == pytest.approx(expected, rel=1.1e-3, abs=1)


def read_log(path, text):
    log, histogram = pytest.importorskip("hdrh.log"), pytest.importorskip("hdrh.histogram").HdrHistogram
    path.write_text(text, encoding="utf-8")
    reader, read = log.HistogramLogReader(str(path), histogram(1, 2**62, 3)), {}
    while (one := reader.get_next_interval_histogram()) is not None:
        read[one.get_tag()] = one
    reader.close()
    return read


def test_a_log_is_read_by_hdrhistogram(tmp_path, with_topics):
    for analysis in all_analyses(with_topics):
        read = read_log(tmp_path / "latency.hlog", hdr_log(analysis))
        counted = analysis.distributions.filter(analysis.distributions["value_ns"] >= 0)["count"].sum()
        topics = sum(int(analysis.topic_messages[f"{name}_ns"].count()) for name in ("one_way", "age"))
        assert sum(one.get_total_count() for one in read.values()) == counted + topics
    (row,) = with_topics.topics.filter(relay_device="laptop").iter_rows(named=True)
    read = read_log(tmp_path / "latency.hlog", hdr_log(with_topics))
    ages = read["/camera/image_robot_to_laptop_age"]
    assert ages.get_value_at_percentile(50) == pytest.approx(row["age_p50_ns"], rel=0.01)


def test_a_timeline_is_read_by_the_protobufs_of_perfetto(tmp_path, with_topics):
    pytest.importorskip("perfetto")
    from perfetto.protos.perfetto.trace.perfetto_trace_pb2 import Trace, TrackEvent

    for analysis in all_analyses(with_topics):
        write_perfetto(analysis, tmp_path / "timeline.pftrace")
        trace = Trace.FromString((tmp_path / "timeline.pftrace").read_bytes())
        tracks = {
            one.track_descriptor.uuid: one.track_descriptor for one in trace.packet if one.HasField("track_descriptor")
        }
        assert all(track.parent_uuid in tracks for track in tracks.values() if track.parent_uuid)
        opened = dict.fromkeys(tracks, 0)
        events = [one for one in trace.packet if one.HasField("track_event")]
        assert all(event.trusted_packet_sequence_id for event in events)
        by_track = Counter()
        last_ns = dict.fromkeys(tracks, 0)
        for event in events:
            uuid, kind = event.track_event.track_uuid, event.track_event.type
            opened[uuid] += 1 if kind == TrackEvent.TYPE_SLICE_BEGIN else -1
            assert opened[uuid] in (0, 1)  # slices of a lane never overlap
            assert event.timestamp >= last_ns[uuid]
            last_ns[uuid] = event.timestamp
            by_track[uuid] += 1
        assert not any(opened.values())
        assert sum(by_track.values()) == 2 * len(list(timeline_slices(analysis)))


def test_all_devices_are_on_one_timeline(with_topics):
    slices = list(timeline_slices(with_topics))
    assert {one.device for one in slices} == {"robot", "laptop"}
    ways = [one for one in slices if one.device == "laptop" and "one way" in one.name]
    stamps = {one.message: one for one in slices if one.device == "robot" and one.name.endswith("stamp")}
    joined = [(stamps[one.message], one) for one in ways]
    assert len(joined) == 299
    # The robot's clock was fitted to the laptop's: the way begins where the stamp's slice ends.
    assert all(abs(stamp.end_ns - way.begin_ns) < 1_000 for stamp, way in joined)
    trips = [one for one in slices if "beacon" in one.name]
    assert max(one.end_ns for one in trips) - min(one.begin_ns for one in ways) < 14 * 10**9


def test_without_the_extra_the_command_names_it(tmp_path, monkeypatch):
    for name in ("perfetto.protos.perfetto.trace.perfetto_trace_pb2", "perfetto.trace_builder.proto_builder"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ModuleNotFoundError, match="perfetto"):
        export(one_message(), "perfetto", tmp_path)


@pytest.mark.parametrize("kind", EXPORT_KINDS)
def test_no_export_has_control_characters(kind, tmp_path, with_topics):
    hides = "a\x1b[2J\r\u202e\x07"
    topics = with_topics.topics.with_columns(data_type=pl.lit(hides), relay_device=pl.lit(hides), vendor=pl.lit(hides))
    for number, analysis in enumerate((hostile(), replace(with_topics, topics=topics))):
        try:
            files = export(analysis, kind, tmp_path / str(number))
        except ModuleNotFoundError:
            pytest.skip(f"{kind} needs an extra that is not here")
        assert files
        for file in files:
            if file.suffix == ".arrow":
                frame = pl.read_ipc(file)
                text = "".join(
                    map(str, frame.select(cs.string(include_categorical=True)).to_dict(as_series=False).values())
                )
                assert "\\x1b" not in text
                assert "\\u202e" not in text
            else:
                data = file.read_bytes()
                assert b"\x1b[" not in data
                assert "\u202e".encode() not in data
                assert b"\r" not in data or file.suffix == ".pftrace"


@cache
def sample():
    return analyze(Path(__file__).parents[3] / "sample_traces" / "same_domain")


ANALYSES = (sample, make_analysis, empty_folder, one_message, ping_without_relay, hostile)


@pytest.mark.parametrize("make", ANALYSES)
def test_bencher_metric_format(make):
    """`{benchmark: {measure: {value, lower_value?, upper_value?}}}`, numbers only; names of 1,024 and 64 characters."""
    analysis = make()
    benchmarks = json.loads(bencher_json(analysis))
    assert len(benchmarks) <= len(analysis.summary)
    for name, measures in benchmarks.items():
        assert 0 < len(name) <= 1024
        assert name.isprintable()
        for measure, metric in measures.items():
            assert 0 < len(measure) <= 64
            assert "value" in metric
            assert metric.keys() <= {"value", "lower_value", "upper_value"}
            assert all(isinstance(number, (int, float)) and math.isfinite(number) for number in metric.values())
            assert metric.get("lower_value", -math.inf) <= metric["value"] <= metric.get("upper_value", math.inf)
    medians = sorted(m["latency_p50"]["value"] for m in benchmarks.values() if "latency_p50" in m)
    known = analysis.details.intervals.filter(metric="latency", percentile="p50")["estimate_ns"].drop_nulls()
    assert medians == pytest.approx(sorted(value for value in known.to_list() if math.isfinite(value)))


@pytest.mark.parametrize("make", ANALYSES)
def test_the_format_of_github_action_benchmark(make):
    """`[{name, unit, value, range?, extra?}]`, not empty; `name` joins the points of a series."""
    for file, text in github_benchmark_files(make()).items():
        entries = json.loads(text)
        assert entries
        assert len({entry["name"] for entry in entries}) == len(entries)
        for entry in entries:
            assert {"name", "unit", "value"} <= entry.keys() <= {"name", "unit", "value", "range"}
            assert isinstance(entry["value"], (int, float))
            assert entry["unit"] == {"smaller": "ns", "bigger": "%"}[re.search("smaller|bigger", file)[0]]
            assert entry.get("range", "\u00b1 1").startswith("\u00b1 ")


@pytest.mark.parametrize("make", ANALYSES)
def test_otava_reads_a_row_with_time_and_commit(make, monkeypatch):
    monkeypatch.setenv("GITHUB_SHA", "1a2b3c4")
    header, row = csv.reader(io.StringIO(otava_csv(make())))
    assert header[:2] == ["time", "commit"]
    assert len(set(header)) == len(header) == len(row)
    assert row[1] == "1a2b3c4"
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ", row[0])
    assert all(re.fullmatch(r"\w+", name) for name in header)
    assert all(math.isfinite(float(value)) for value in row[2:] if value)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_otava_finds_a_change_of_a_fifth_in_sixty_commits(tmp_path):
    """Commits vary by 5 %."""
    otava = otava_alone(tmp_path)
    header, row = csv.reader(io.StringIO(otava_csv(sample())))
    column = next(index for index, name in enumerate(header) if name.endswith("latency_p50"))
    factors = np.random.default_rng(20_261_127).normal(1, 0.05, 60) * np.repeat([1, 1.2], [40, 20])
    lines = [header]
    for number, factor in enumerate(factors):
        times = [
            f"{float(row[column]) * factor:.6g}" if index == column else row[index] for index in range(2, len(row))
        ]
        lines.append([f"2026-{1 + number // 28:02}-{1 + number % 28:02}T00:00:00Z", f"c{number:02}", *times])
    (tmp_path / "latency.csv").write_text("".join(",".join(line) + "\n" for line in lines))
    (tmp_path / "otava.yaml").write_text(
        "tests: {latency: {type: csv, file: latency.csv, time_column: time, attributes: [commit], "
        f"metrics: {{p50: {{column: {header[column]}, direction: -1}}}}, csv_options: {{delimiter: ','}}}}}}\n"
    )
    command = [otava, "analyze", "latency", "--config-file", "otava.yaml", "--since", "2025-01-01"]
    shown = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=True).stdout.splitlines()
    (change,) = [index for index, line in enumerate(shown) if "%" in line]
    assert "c40" in shown[change + 2]


def test_names_do_not_follow_the_machine_or_what_else_was_measured(tmp_path):
    written = [
        path.name for kind in ("bencher", "github-benchmark", "otava") for path in export(sample(), kind, tmp_path)
    ]
    assert written == [
        "bencher.json",
        "github-benchmark-smaller.json",
        "github-benchmark-bigger.json",
        "otava.csv",
        "otava.yaml",
    ]
    names = list(json.loads((tmp_path / "bencher.json").read_text()))
    assert names
    assert all("payload_bytes=" in name and "_device=" not in name for name in names)
    assert max(map(len, names)) < 150
    assert not any("=reliable" in name or "depth=10" in name or "relay_vendor" in name for name in names)

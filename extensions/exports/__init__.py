"""Formats of other programs: dashboards, trace viewers, histories."""

from dds_trace.base.extension import Extension

EXTENSION = Extension(
    exports={
        "openmetrics": "openmetrics:export",
        "bencher": "history:export_bencher",
        "github-benchmark": "history:export_github_benchmark",
        "otava": "history:export_otava",
        "hdr": "hdr_log:export",
        "perfetto": "perfetto:export",
    },
    parts={"derived": "foxglove:write_derived"},
)

"""What one job needs by itself: its recording, analysis, report and command in one package, a row of `EXTENSIONS`."""

from dds_trace.base.extension import Extension

EXTENSIONS = (
    Extension(
        name="bags",
        commands={"bag": "command:app", "recover": "recover_command:app"},
        payloads={"bag": "payload:BAG"},
        storages={".db3": "sqlite_rows:SqliteSource"},
        parts={
            "judge_tap": "limits:judge_tap",
            "are_drives": "drives:are_drives",
            "compare_drives": "drives:compare_drives",
            "side_by_side": "drives:side_by_side",
            "bag_report": "report:BagReport",
        },
    ),
    Extension(
        name="wire",
        checks={"capture": "ring:permitted"},
        details={"wire": "analyze:wire_frames"},
        figures={"wire": "figures:FIGURES"},
        findings={"wire": "findings:CHECKS"},
        parts={"wire": "capture:open_wire"},
    ),
    Extension(
        name="topics",
        roles={"tap": "recording:TapRecording", "beacon": "beacon:BeaconRecording"},
        payloads={"topic": "payload:TOPIC"},
        parts={
            "topics": "frames:find_topics",
            "topic_sentences": "report:topic_sentences",
            "topic_sections": "report:topic_sections",
        },
    ),
    Extension(
        name="bridges",
        commands={"bridge": "command:app"},
        choices={"--bridge": ":BRIDGE_MODULES"},
        checks={"bridges": "command:installed"},
        parts={"check_bridge": "running:check_requested_bridge", "open_bridge": "running:open_bridge"},
    ),
    Extension(
        name="campaigns",
        commands={
            "sweep": "commands.sweep:app",
            "sweep new": "commands.new:app",
            "capacity": "commands.sweep:capacity",
            "explain rates": "commands.explain:rates",
            "explain size": "commands.explain:size",
            "advise": "commands.advise:app",
            "choose": "commands.choose:app",
            "studio": "studio.command:app",
        },
        checks={"links": "station.namespaces:permitted"},
        details={"recoveries": "recovery:recovery_frame", "fan_out": "fan_out:fan_out_frames"},
        parts={
            "recommend": "recommend:recommend_settings",
            "advice": "recommendation:recommendation_info",
            "estimator": "learning.model:Estimator",
            "load": "load:loaded",
        },
    ),
    Extension(
        name="gates",
        commands={"compare": "command:app"},
        details={"costs": "costs:cost_frames"},
        parts={
            "read_limits": "limits_file:read_limits",
            "topic_limits": "limits_file:topic_limits",
            "judge_topics": "report:judge_topics",
        },
    ),
    Extension(
        name="exports",
        exports={
            "openmetrics": "openmetrics:export",
            "bencher": "history:export_bencher",
            "github-benchmark": "history:export_github_benchmark",
            "otava": "history:export_otava",
            "hdr": "hdr_log:export",
            "perfetto": "perfetto:export",
        },
        parts={"derived": "foxglove:write_derived"},
    ),
    Extension(name="live", commands={"watch": "command:app"}, parts={"presenter": "notebook"}),
    Extension(
        name="service",
        commands={"record status": "command:app"},
        parts={"upkeep": "upkeep:Upkeep", "causes_of_relays": "running:causes_of_relays"},
    ),
    Extension(
        name="cluster",
        parts={
            "cluster": "engine:ClusterEngine",
            "find_remote": "remote:find_remote",
            "copy_remote": "remote:local_copy",
        },
    ),
)
"""In the order in which the main house asks them."""

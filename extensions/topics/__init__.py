"""Topics of a running robot: tap, beacon, chains."""

from dds_trace.base.extension import Extension

EXTENSION = Extension(
    roles={"tap": "recording:TapRecording", "beacon": "beacon:BeaconRecording"},
    payloads={"topic": "payload:TOPIC"},
    parts={
        "topics": "frames:find_topics",
        "topic_sentences": "report:topic_sentences",
        "topic_sections": "report:topic_sections",
    },
)

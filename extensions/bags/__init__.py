"""Recordings of other programs: read them, say what is missing, recover them."""

from dds_trace.base.extension import Extension

EXTENSION = Extension(
    commands={"bag": "command:app"},
    payloads={"bag": "payload:BAG"},
    storages={".db3": "sqlite_rows:SqliteSource"},
    parts={
        "is_recording": "recover:is_of_others",
        "recover": "recover:recover_recording",
        "judge_tap": "printing:judge_tap",
    },
)

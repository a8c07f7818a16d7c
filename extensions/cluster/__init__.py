"""Analysis on the workers of a Dask scheduler, traces in object storage."""

from dds_trace.base.extension import Extension

EXTENSION = Extension(
    parts={"cluster": "engine:ClusterEngine", "find_remote": "remote:find_remote", "copy_remote": "remote:local_copy"}
)

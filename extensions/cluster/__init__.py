"""Analysis on the workers of a Dask scheduler, traces in object storage."""

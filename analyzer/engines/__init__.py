"""A campaign in batches that fit into memory, worked through here or on a cluster, and merged."""

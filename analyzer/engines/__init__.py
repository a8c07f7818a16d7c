"""A campaign in batches that fit into memory, processed here or on a cluster, and merged."""

"""Bridges between two DDS domains: configure, start, supervise."""

BRIDGE_MODULES = {
    "builtin": "dds_trace.extensions.bridges.builtin",
    "builtin-zenoh": "dds_trace.extensions.bridges.builtin_zenoh",
    "zenoh-bridge-dds": "dds_trace.extensions.bridges.zenoh_bridge_dds",
    "zenoh-bridge-ros2dds": "dds_trace.extensions.bridges.zenoh_bridge_ros2dds",
    "integration-service": "dds_trace.extensions.bridges.integration_service",
    "ddsrouter": "dds_trace.extensions.bridges.ddsrouter",
    "routing-service": "dds_trace.extensions.bridges.routing_service",
    "domain_bridge": "dds_trace.extensions.bridges.domain_bridge",
}
"""Name -> module with its `BRIDGE`, imported at first use."""

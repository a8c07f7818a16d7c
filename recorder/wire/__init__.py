"""What a message costs on the wire: packets of the run's interfaces, counted by class and followed by message.

`WireCapture` starts a process that watches interfaces (`process`): a `ring` that the kernel fills gives frames, whose headers
(`packets`) a `tally` turns into `WireCounts` and rows of messages. What the kernel counts itself stands beside it (`kernel_counters`, `tcp_info`).
"""

from typing import TYPE_CHECKING

from dds_trace.lazy import contents_page

if TYPE_CHECKING:
    from .capture import WireCapture, WireResult
    from .counts import ClassCount, WireCounts
    from .kernel_counters import InterfaceCount, IpCounts
    from .messages import RepeatCount
    from .options import WireOptions, domain_ports
    from .packets.packet_filter import PortRange
    from .tcp_info import TcpConnection, read_connections, read_socket
else:
    __getattr__, __dir__ = contents_page(__name__)

__all__ = [
    "ClassCount",
    "InterfaceCount",
    "IpCounts",
    "PortRange",
    "RepeatCount",
    "TcpConnection",
    "WireCapture",
    "WireCounts",
    "WireOptions",
    "WireResult",
    "domain_ports",
    "read_connections",
    "read_socket",
]

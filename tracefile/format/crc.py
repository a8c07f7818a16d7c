"""CRC-32, as MCAP and zlib have it, from the faster library where it is installed: a fifth of reading lz4 is this."""

try:
    from isal.isal_zlib import crc32
except ImportError:  # a device that only records, or that has no wheel for it
    from zlib import crc32

__all__ = ["crc32"]

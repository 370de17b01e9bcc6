"""Size of data that are packed by DEFLATE, before a library that knows no bound unpacks them."""

import zlib

LARGEST_RATIO = 1032
"""Largest ratio by which DEFLATE packs: 258 bytes in 2 bits (RFC 1951)."""

PIECE = 1 << 20
"""Number of bytes that are unpacked at a time."""


def inflated_size(data: bytes, most: int) -> int:
    """Count the bytes that zlib data hold; once there are more than `most`, stop.

    Raises
    ------
    zlib.error
        If the data are damaged.

    Examples
    --------
    >>> inflated_size(zlib.compress(bytes(5000)), 10_000_000)
    5000
    """
    unpacker, count = zlib.decompressobj(), 0
    while count <= most and not unpacker.eof:
        piece = unpacker.decompress(data, PIECE)
        if not piece:
            break
        count, data = count + len(piece), unpacker.unconsumed_tail
    return count

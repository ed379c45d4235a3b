"""LZF, with which the Point Cloud Library packs points."""


def unpack(packed: bytes, size: int) -> bytes:
    """The bytes that were packed.

    Args:
        packed: Tokens: a byte below 32 and so many bytes more than it says as they are, or a length in the upper 3
            bits and a distance back in the other 13, with a byte of more length between where the 3 bits are all set.
        size: Number of the bytes that were packed.

    Raises:
        ValueError: If the tokens do not fit, or give another number of bytes.
    """
    out = bytearray()
    at, end = 0, len(packed)
    try:
        while at < end and len(out) <= size:
            token = packed[at]
            at += 1
            if token < 32:
                out += packed[at : at + token + 1]
                at += token + 1
                continue
            length = token >> 5
            if length == 7:
                length += packed[at]
                at += 1
            start = len(out) - ((token & 31) << 8) - packed[at] - 1
            at += 1
            length += 2
            if start < 0:
                raise ValueError("a repetition begins before the data")
            # What is repeated may reach into its own repetition.
            piece = out[start : start + length]
            out += (piece * (length // len(piece) + 1))[:length]
    except IndexError as problem:
        raise ValueError("the packed data is cut short") from problem
    if len(out) != size or at != end:
        raise ValueError(f"found {len(out)} bytes of {size}")
    return bytes(out)

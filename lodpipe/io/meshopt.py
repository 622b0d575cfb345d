"""EXT_meshopt_compression and KHR_meshopt_compression: bitstreams (their appendix A) and filters (appendix B)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lodpipe.core.errors import AssetError

EXTENSIONS = ("KHR_meshopt_compression", "EXT_meshopt_compression")
_GROUP = 16
#: How many sentinels (all bits set) each byte holds, for deltas of 1, 2 and 4 bits.
_CODES = np.arange(256, dtype=np.uint8)[:, None]
_SENTINELS = {
    bits: ((_CODES >> np.arange(0, 8, bits, dtype=np.uint8)) & ((1 << bits) - 1) == (1 << bits) - 1).sum(axis=1)
    for bits in (1, 2, 4)
}


def decode(data: bytes, mode: str, method: str, count: int, stride: int) -> NDArray[np.uint8]:
    """The `count` elements of `stride` bytes, one after another. Raises AssetError for an invalid stream."""
    try:
        if mode == "ATTRIBUTES":
            if stride % 4 or not 4 <= stride <= 256:
                raise AssetError(f"byteStride {stride} is not a multiple of 4 up to 256")
            return _filtered(_attributes(data, count, stride), method)
        if mode not in ("TRIANGLES", "INDICES") or stride not in (2, 4):
            raise AssetError(f"mode '{mode[:20]}' with byteStride {stride} is not valid")
        values = _triangles(data, count) if mode == "TRIANGLES" else _indices(data, count)
        return np.array(values, np.uint64).astype(f"<u{stride}").view(np.uint8)
    except IndexError as error:
        raise AssetError(
            "the compressed data ends too early", advice="the file is damaged: copy or export it again"
        ) from error


def _attributes(data: bytes, count: int, stride: int) -> NDArray[np.uint8]:
    """Mode 0 -> (count, stride)."""
    if not data or data[0] not in (0xA0, 0xA1):
        raise AssetError("the compressed data has an unknown header")
    version = data[0] & 1
    tail = stride + (stride // 4 if version else 0)
    end = len(data) - max(tail, 24 if version else 32)
    if end < 1:
        raise AssetError("the compressed data ends too early", advice="the file is damaged: copy or export it again")
    base = np.frombuffer(data, np.uint8, stride, len(data) - tail)
    channels = data[len(data) - stride // 4 :] if version else bytes(stride // 4)
    deltas = _deltas(data, end, count, stride, version)
    result = np.empty((count, stride), np.uint8)
    for channel, kind in enumerate(channels):
        part = slice(4 * channel, 4 * channel + 4)
        result[:, part] = _undo(deltas[part, :count], base[part], kind)
    return result


def _undo(deltas: NDArray[np.uint8], base: NDArray[np.uint8], kind: int) -> NDArray[np.uint8]:
    """Four bytes of each element, (count, 4), from their deltas (4, count) and the baseline."""
    packed = np.ascontiguousarray(deltas.T)
    if kind in (0, 1):  # zigzag-coded differences of bytes, or of 16-bit values
        word = np.dtype("u1" if kind == 0 else "<u2")
        coded = packed.view(word)
        steps = (coded >> 1) ^ (~(coded & 1) + word.type(1))
        return (np.cumsum(steps, axis=0, dtype=word) + base.view(word)).astype(word, copy=False).view(np.uint8)
    if kind & 15 == 2:  # exclusive or of 32-bit values, rotated
        turn = np.uint32(kind >> 4)
        coded = packed.view("<u4")[:, 0]
        steps = (coded >> turn) | (coded << ((np.uint32(32) - turn) & np.uint32(31)))  # the encoder turned left
        values = np.bitwise_xor.accumulate(steps) ^ base.view("<u4")[0]
        undone: NDArray[np.uint8] = values.astype("<u4")[:, None].view(np.uint8)
        return undone
    raise AssetError(f"channel mode {kind} of the compressed data is not known")


def _deltas(data: bytes, end: int, count: int, stride: int, version: int) -> NDArray[np.uint8]:
    """Deltas (stride, count rounded up to groups of 16).

    Where a group starts depends on all before it: one pass finds the starts, then all groups of one bit width are
    unpacked at once.
    """
    source = np.frombuffer(data + bytes(_GROUP), np.uint8)  # the last group may be shorter than 16
    sums = {bits: np.concatenate([[0], np.cumsum(table[source])]).data for bits, table in _SENTINELS.items()}
    block = min(8192 // stride & ~15, 256)
    groups = -(-count // _GROUP)
    starts: dict[int, tuple[list[int], list[int]]] = {bits: ([], []) for bits in (1, 2, 4, 8)}
    at = 1
    for first in range(0, count, block):
        elements = min(block, count - first)
        in_block = -(-elements // _GROUP)
        control = data[at : at + stride // 4] if version else b""
        at += len(control)
        for lane in range(stride):
            mode = control[lane // 4] >> 2 * (lane % 4) & 3 if version else 4
            if mode == 2:
                continue
            target = lane * groups + first // _GROUP
            if mode == 3:  # stored as they are, without the padding to groups
                starts[8][0].extend(range(target, target + in_block))
                starts[8][1].extend(range(at, at + elements, _GROUP))
                at += elements
                continue
            widths = ((0, 1, 2, 4), (1, 2, 4, 8), (), (), (0, 2, 4, 8))[mode]
            header = at
            at += (in_block + 3) // 4
            for group in range(in_block):
                bits = widths[data[header + group // 4] >> 2 * (group % 4) & 3]
                if bits == 0:
                    continue
                places, offsets = starts[bits]
                places.append(target + group)
                offsets.append(at)
                at += 2 * bits
                if bits < 8:
                    at += sums[bits][at] - sums[bits][at - 2 * bits]
        if at > end:
            raise AssetError(
                "the compressed data ends too early", advice="the file is damaged: copy or export it again"
            )
    if at != end:
        raise AssetError(
            "the compressed data is longer than its elements", advice="the file is damaged: copy or export it again"
        )
    result = np.zeros((stride * groups, _GROUP), np.uint8)
    for bits, (places, offsets) in starts.items():
        if places:
            result[places] = _unpack(source, np.array(offsets), bits)
    return result.reshape(stride, groups * _GROUP)


def _unpack(source: NDArray[np.uint8], offset: NDArray[Any], bits: int) -> NDArray[np.uint8]:
    """Groups (G, 16) that start at `offset` (G,): a small code, or a sentinel and the byte after the codes."""
    packed = source[offset[:, None] + np.arange(2 * bits)]
    if bits == 8:
        return packed
    shifts = np.arange(0, 8, bits, dtype=np.uint8)
    if bits > 1:
        shifts = shifts[::-1]
    top = np.uint8((1 << bits) - 1)
    codes = (packed[:, :, None] >> shifts & top).reshape(len(packed), _GROUP)
    sentinel = codes == top
    extra = offset[:, None] + 2 * bits - 1 + np.cumsum(sentinel, axis=1)
    codes[sentinel] = source[extra[sentinel]]
    return codes


def _triangles(data: bytes, count: int) -> list[int]:
    """Mode 1: a code for each triangle, with first-in-first-out lists of recent edges and vertices."""
    if count % 3 or data[:1] != b"\xe1" or len(data) < 17 + count // 3:
        raise AssetError("the compressed triangles have an unknown header or are cut off")
    table = data[-16:]
    stop = len(data) - 16
    edges: list[tuple[int, int]] = []
    vertices: list[int] = []
    result: list[int] = []
    following = last = 0
    at = 1 + count // 3

    def explicit() -> int:
        nonlocal at, last
        value, at = _leb128(data, at)
        last = (last + ((value >> 1) ^ -(value & 1))) & 0xFFFFFFFF
        return last

    def corner(code: int) -> int:
        nonlocal following
        if code == 0:
            following += 1
            return following - 1
        return explicit() if code == 15 else vertices[-code]

    for code in data[1 : 1 + count // 3]:
        high, low = code >> 4, code & 15
        if high < 15:
            a, b = edges[-1 - high]
            if low == 0:
                c = following
                following += 1
            elif low < 13:
                c = vertices[-1 - low]
            elif low < 15:
                c = last = (last + (1 if low == 14 else -1)) & 0xFFFFFFFF
            else:
                c = explicit()
            edges += ((c, b), (a, c))
            if low == 0 or low > 12:
                vertices.append(c)
        else:
            if low < 14:
                pair = table[low]
            else:
                pair = data[at]
                at += 1
                if pair == 0:
                    following = 0
            a = corner(15 if low == 15 else 0)
            b = corner(pair >> 4)
            c = corner(pair & 15)
            edges += ((b, a), (c, b), (a, c))
            vertices.append(a)
            if pair >> 4 in (0, 15):
                vertices.append(b)
            if pair & 15 in (0, 15):
                vertices.append(c)
        result += (a, b, c)
        if len(edges) > 4096:
            del edges[:-16], vertices[:-16]
    if at != stop:
        raise AssetError(
            "the compressed triangles do not end where they should",
            advice="the file is damaged: copy or export it again",
        )
    return result


def _indices(data: bytes, count: int) -> list[int]:
    """Mode 2: zigzag differences to one of two running values."""
    if data[:1] != b"\xd1" or len(data) < 5 + count:
        raise AssetError("the compressed indices have an unknown header or are cut off")
    last = [0, 0]
    at = 1
    result = []
    for _ in range(count):
        value, at = _leb128(data, at)
        which = value & 1
        last[which] = (last[which] + ((value >> 2) ^ -(value >> 1 & 1))) & 0xFFFFFFFF
        result.append(last[which])
    if at != len(data) - 4:
        raise AssetError(
            "the compressed indices do not end where they should", advice="the file is damaged: copy or export it again"
        )
    return result


def _leb128(data: bytes, at: int) -> tuple[int, int]:
    """An unsigned 32-bit number of 1 to 5 bytes, 7 bits each, and the place after it."""
    value = 0
    for shift in range(0, 35, 7):
        byte = data[at]
        at += 1
        value |= (byte & 127) << shift
        if byte < 128:
            return value & 0xFFFFFFFF, at
    raise AssetError(
        "a number of the compressed data is longer than 5 bytes", advice="the file is damaged: copy or export it again"
    )


def _filtered(elements: NDArray[np.uint8], method: str) -> NDArray[np.uint8]:
    stride = elements.shape[1]
    if method == "NONE":
        return elements.reshape(-1)
    sizes = {"OCTAHEDRAL": (4, 8), "QUATERNION": (8,), "COLOR": (4, 8)}
    if method == "EXPONENTIAL":
        return _exponential(elements)
    if method not in sizes or stride not in sizes[method]:
        raise AssetError(f"filter '{method[:20]}' with byteStride {stride} is not valid")
    size = stride // 4
    if method == "COLOR":
        return _colour(elements.view(f"<u{size}"), size)
    values = elements.view(f"<i{size}")
    top = float(np.iinfo(values.dtype).max)
    decoded = _octahedral(values) if method == "OCTAHEDRAL" else _quaternion(values)
    result = values.copy()
    axes = slice(0, 3) if method == "OCTAHEDRAL" else slice(0, 4)
    result[:, axes] = _round(decoded * top)
    return result.view(np.uint8).reshape(-1)


def _octahedral(values: NDArray[Any]) -> NDArray[np.float64]:
    given = values.astype(np.float64)
    xy = given[:, :2] / np.maximum(given[:, 2:3], 1.0)
    z = 1.0 - np.abs(xy).sum(axis=1)
    xy -= np.copysign(np.minimum(z, 0.0)[:, None], xy)
    vector = np.column_stack([xy, z])
    unit: NDArray[np.float64] = vector / np.maximum(np.linalg.norm(vector, axis=1, keepdims=True), 1e-30)
    return unit


def _quaternion(values: NDArray[Any]) -> NDArray[np.float64]:
    given = values.astype(np.int64)
    one = (given[:, 3] | 3).astype(np.float64)
    three = given[:, :3] / one[:, None] / np.sqrt(2.0)
    largest = np.sqrt(np.maximum(0.0, 1.0 - (three**2).sum(axis=1)))
    result = np.empty((len(given), 4))
    rows = np.arange(len(given))
    result[rows, given[:, 3] & 3] = largest
    for k in range(3):
        result[rows, (given[:, 3] + 1 + k) & 3] = three[:, k]
    return result


def _exponential(elements: NDArray[np.uint8]) -> NDArray[np.uint8]:
    words = elements.view("<i4")
    mantissa = (words << 8) >> 8
    floats: NDArray[Any] = np.ldexp(mantissa.astype(np.float64), words >> 24).astype("<f4")
    return floats.view(np.uint8).reshape(-1)


def _colour(values: NDArray[Any], size: int) -> NDArray[np.uint8]:
    luma, alpha = values[:, 0].astype(np.int64), values[:, 3].astype(np.int64)
    signed = values.view(f"<i{size}").astype(np.int64)
    orange, green = signed[:, 1], signed[:, 2]
    scale = (1 << np.floor(np.log2(np.maximum(alpha, 1))).astype(np.int64) + 1) - 1
    alpha = alpha & scale >> 1
    mixed = np.stack([luma + orange - green, luma + green, luma - orange - green, alpha << 1 | alpha & 1], axis=1)
    top = 255.0 if size == 1 else 65535.0
    whole: NDArray[Any] = np.clip(_round(mixed * (top / scale)[:, None]), 0, top).astype(f"<u{size}")
    return whole.view(np.uint8).reshape(-1)


def _round(values: NDArray[Any]) -> NDArray[Any]:
    """To the nearest whole number, halves away from zero."""
    rounded: NDArray[Any] = np.copysign(np.floor(np.abs(values) + 0.5), values)
    return rounded

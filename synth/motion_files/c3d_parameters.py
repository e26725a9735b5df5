"""Header and parameters of a C3D file, in the number formats of three kinds of processors.

Layout after the C3D user guide (Motion Lab Systems, c3d.org): blocks of 512 bytes; the first is a header,
whose first byte is the block where the parameters begin, which are in groups.
"""

import math
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BLOCK = 512
"""Bytes that positions in the file are counted in."""
INTEL, DEC, MIPS = 84, 85, 86
"""Kinds of processors, by which numbers are written."""
RATES = (1.0, 10_000.0)
"""Least and most frames per second that a rate may be."""


@dataclass(frozen=True)
class C3dFile:
    """Bytes of a file with its header, and its parameters as "GROUP:NAME", each with the bodies it has."""

    data: bytes
    processor: int
    parameters: dict[str, list[bytes]]
    behind: int
    """Byte behind the parameters, where data begin if nothing else is stated."""

    @staticmethod
    def of(data: bytes, assumed: list[str]) -> "C3dFile":
        stated = max(data[0], 1)
        blocks = (stated, *range(2, min(len(data) // BLOCK, 20) + 1))
        block = next((b for b in blocks if _begins_parameters(data, b)), 0)
        if not block:
            assumed.append("no parameters were found; what the header states is used")
            processors = (INTEL, MIPS, DEC)
            rates = [C3dFile(data, p, {}, BLOCK).header_float(20) for p in processors]
            usable = (p for p, r in zip(processors, rates, strict=True) if RATES[0] <= r <= RATES[1])
            return C3dFile(data, next(usable, INTEL), {}, BLOCK)
        if block != stated:
            assumed.append(f"the parameters begin at block {block}, where the header states {data[0]}")
        begin = (block - 1) * BLOCK
        size, processor = data[begin + 2] or 255, data[begin + 3]
        section = data[begin : begin + size * BLOCK]
        parameters = _parameters(section, processor)
        for name, bodies in parameters.items():
            if len(bodies) > 1 and name.startswith(("POINT:", "ANALOG:USED", "ANALOG:RATE")):
                assumed.append(f"{name} is there {len(bodies)} times; the one that fits is used")
        return C3dFile(data, processor, parameters, begin + len(section))

    def header_word(self, at: int) -> int:
        """Unsigned word of the header at a byte."""
        return int(words_of(self.data[at : at + 2], self.processor)[0]) & 0xFFFF

    def header_float(self, at: int) -> float:
        """Number of the header at a byte."""
        return float(floats_of(self.data[at : at + 4], self.processor)[0])

    def numbers(self, name: str) -> list[float]:
        """First number of each body of a parameter that has any; words unsigned."""
        return [values[0] for body in self.parameters.get(name, []) if (values := self._values(body))]

    def wide_number(self, name: str) -> list[float]:
        """Number of a parameter that is written as two words, the lower one first."""
        values = [self._values(body) for body in self.parameters.get(name, [])]
        return [v[0] + 65536 * v[1] if len(v) == 2 else v[0] for v in values if v]

    def _values(self, body: bytes) -> list[float]:
        kind, _, content = _content(body)
        whole = content[: len(content) // max(kind, 1) * max(kind, 1)]
        if kind == 1:
            return [float(v) for v in whole]
        if kind == 2:
            return [float(v & 0xFFFF) for v in words_of(whole, self.processor).tolist()]
        return [float(v) for v in floats_of(whole, self.processor)] if kind == 4 else []

    def texts(self, name: str) -> list[str]:
        """Texts of a parameter, of the body that names most where it has several."""
        found = [_texts(body) for body in self.parameters.get(name, [])]
        return max(found, key=lambda texts: len(set(texts) - {""}), default=[])


def _begins_parameters(data: bytes, block: int) -> bool:
    head = data[(block - 1) * BLOCK :][:6]
    return len(head) == 6 and block > 1 and head[3] in (INTEL, DEC, MIPS) and head[4] != 0


def _parameters(section: bytes, processor: int) -> dict[str, list[bytes]]:
    """Bodies of parameters by "GROUP:NAME". An entry: length of its name, group (negative: it describes one),
    name, bytes from there to the next entry, body."""
    groups: dict[int, str] = {}
    found: list[tuple[int, str, bytes]] = []
    at = 4
    while at + 4 < len(section):
        length, group = struct.unpack_from("bb", section, at)
        behind = at + 2 + abs(length)
        if not length or not group or behind + 2 > len(section):
            break
        name = section[at + 2 : behind].decode("latin-1").strip().upper()
        step = int(words_of(section[behind : behind + 2], processor)[0])
        body = section[behind + 2 : behind + step if step > 2 else None]
        if group < 0:
            groups[-group] = name
        else:
            found.append((group, name, body))
        if step <= 2:
            break
        at = behind + step
    result: dict[str, list[bytes]] = {}
    for group, name, body in found:
        result.setdefault(f"{groups.get(group, group)}:{name}", []).append(body)
    return result


def _content(body: bytes) -> tuple[int, tuple[int, ...], bytes]:
    """Type (-1 text, else bytes a number), dimensions, and bytes of a parameter's values, as far as there."""
    if len(body) < 2:
        return 0, (), b""
    kind, rank = struct.unpack_from("bB", body)
    shape = tuple(body[2 : 2 + rank])
    return kind, shape, body[2 + rank :][: abs(kind) * math.prod(shape)]


def _texts(body: bytes) -> list[str]:
    kind, shape, content = _content(body)
    width = shape[0] if shape else 1
    if kind != -1 or not width:
        return []
    return [
        content[i : i + width].decode("utf-8", "replace").strip(" \0") for i in range(0, len(content), width)
    ]


def words_of(data: bytes, processor: int) -> NDArray[np.int16]:
    """Signed words of a processor."""
    return np.frombuffer(data, ">i2" if processor == MIPS else "<i2")


def floats_of(data: bytes, processor: int) -> NDArray[np.float32]:
    """Numbers of a processor. DEC's are IEEE's times four with the two words exchanged."""
    if processor == DEC:
        swapped = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1].copy()
        return np.asarray(swapped.view("<f4")[:, 0] / 4, np.float32)
    return np.frombuffer(data, ">f4" if processor == MIPS else "<f4")

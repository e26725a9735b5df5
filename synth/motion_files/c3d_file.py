"""C3D files from laboratories, including files whose header and parameters disagree.

Layout after the C3D user guide (Motion Lab Systems, c3d.org): blocks of 512 bytes. The first block is a
header, whose first byte is the block number of the parameters. Parameters are in groups. After them come,
frame by frame, four numbers per point (x, y, z, residual) and the analog samples. Where header and parameters
differ, the statement that fits the data is used; the library ``c3d`` refuses such files.
"""

import itertools
import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float64
from sensors.errors import FormatError
from synth.motion_files.vertical_axis import AXES

BLOCK = 512  # bytes
INTEL, DEC, MIPS = 84, 85, 86  # processors, by which numbers are written
RATES = (1.0, 10_000.0)  # least and most frames a second
DEFAULT_RATE = 100.0  # frames a second of a file without a rate: the commonest of motion capture
IMPLAUSIBLE = 0.02  # share of impossible points; in five recordings 0 if the layout fits, else 0.11 to 0.3
SAMPLE = 64  # frames, and points of each, by which a layout is judged; untuned
_ALL = 2**31  # frames where no number of them is stated
_MOST_16 = 0xFFFF
_MOST_STATEMENTS = 4  # different values of one number that are tried; untuned


class C3dPoints(NamedTuple):
    """Points of a C3D file.

    labels: M names. positions: float64 (F, M, 3) in the file's unit and axes, NaN where not seen. unit: "" if
    none is stated. up: a direction of ``AXES`` or "". assumed: sentences on assumptions.
    """

    labels: tuple[str, ...]
    positions: Float64
    frames_per_second: float
    unit: str
    up: str
    assumed: tuple[str, ...]


def parse_c3d(data: bytes, most: int) -> C3dPoints:
    """Read the points of a C3D file's bytes.

    Raises FormatError for another format, and when frames times points are 0 or more than ``most``.
    """
    if len(data) < BLOCK or data[1] != 0x50:
        raise FormatError("the file has no C3D header; give a C3D file")
    assumed: list[str] = []
    file = _File.of(data, assumed)
    layout = _layout(file, assumed)
    if layout.frames * layout.points > most:
        claim = f"{layout.frames} frames of {layout.points} points"
        raise FormatError(f"{claim} are over {most} positions; cut the recording")
    numbers, scale = _decoded(_raw(file, layout)), _scale(file, assumed)
    with np.errstate(invalid="ignore"):  # a NaN that signals
        positions = numbers[..., :3] * np.float64(1 if layout.floats else scale)
        positions[~(np.isfinite(numbers).all(axis=2) & (numbers[..., 3] >= 0))] = np.nan
    vertical = next(iter(file.texts("POINT:Y_SCREEN")), "").strip().lower().lstrip("+")
    return C3dPoints(
        _labels(file, layout.points, assumed),
        positions,
        _rate(file, assumed),
        next(iter(file.texts("POINT:UNITS")), "").lower(),
        vertical if vertical in AXES else "",
        tuple(assumed),
    )


class _Value(NamedTuple):
    """Content of a parameter, as far as the file holds it; words are unsigned."""

    numbers: list[float]
    texts: list[str]


@dataclass(frozen=True)
class _File:
    """Bytes of a file, its parameters as "GROUP:NAME" with all their values, and the offset after them."""

    data: bytes
    processor: int
    parameters: dict[str, list[_Value]]
    behind: int

    @staticmethod
    def of(data: bytes, assumed: list[str]) -> "_File":
        stated = max(data[0], 1)
        blocks = (stated, *range(2, min(len(data) // BLOCK, 20) + 1))
        block = next((b for b in blocks if _begins_parameters(data, b)), 0)
        if not block:
            assumed.append("no parameters were found; what the header states is used")
            processors = (INTEL, MIPS, DEC)
            rates = [_File(data, p, {}, BLOCK).header_float(20) for p in processors]
            usable = (p for p, r in zip(processors, rates, strict=True) if RATES[0] <= r <= RATES[1])
            return _File(data, next(usable, INTEL), {}, BLOCK)
        if block != stated:
            assumed.append(f"the parameters begin at block {block}, where the header states {data[0]}")
        begin = (block - 1) * BLOCK
        size, processor = data[begin + 2] or 255, data[begin + 3]
        section = data[begin : begin + size * BLOCK]
        parameters = _parameters(section, processor)
        for name, values in parameters.items():
            if len(values) > 1 and name.startswith(("POINT:", "ANALOG:USED", "ANALOG:RATE")):
                assumed.append(f"{name} is there {len(values)} times; the one that fits is used")
        return _File(data, processor, parameters, begin + len(section))

    def header_word(self, at: int) -> int:
        return int(_words(self.data[at : at + 2], self.processor)[0]) & 0xFFFF

    def header_float(self, at: int) -> float:
        return float(_floats(self.data[at : at + 4], self.processor)[0])

    def numbers(self, name: str) -> list[float]:
        """Return the first number of each entry of a parameter, which a file may hold several times."""
        return [value.numbers[0] for value in self.parameters.get(name, []) if value.numbers]

    def wide_number(self, name: str) -> list[float]:
        """Return the numbers of a parameter that is written as two words, the lower one first, by entry."""
        values = [value.numbers for value in self.parameters.get(name, [])]
        return [v[0] + 65536 * v[1] if len(v) == 2 else v[0] for v in values if v]

    def texts(self, name: str) -> list[str]:
        """Return the texts of a parameter; of several entries, the one with most names."""
        found = [value.texts for value in self.parameters.get(name, [])]
        return max(found, key=lambda texts: len(set(texts) - {""}), default=[])


def _begins_parameters(data: bytes, block: int) -> bool:
    head = data[(block - 1) * BLOCK :][:6]
    return len(head) == 6 and block > 1 and head[3] in (INTEL, DEC, MIPS) and head[4] != 0


def _parameters(section: bytes, processor: int) -> dict[str, list[_Value]]:
    """Parse the parameter entries: length of the name, group (negative in its description), name, offset to
    the next entry, content.
    """
    groups: dict[int, str] = {}
    found: list[tuple[int, str, _Value]] = []
    at = 4
    while at + 4 < len(section):
        length, group = struct.unpack_from("bb", section, at)
        behind = at + 2 + abs(length)
        if not length or not group or behind + 2 > len(section):
            break
        name = section[at + 2 : behind].decode("latin-1").strip().upper()
        step = int(_words(section[behind : behind + 2], processor)[0])
        if group < 0:
            groups[-group] = name
        else:
            body = section[behind + 2 : behind + step if step > 2 else None]
            found.append((group, name, _value(body, processor)))
        if step <= 2:
            break
        at = behind + step
    result: dict[str, list[_Value]] = {}
    for group, name, value in found:
        result.setdefault(f"{groups.get(group, group)}:{name}", []).append(value)
    return result


def _value(body: bytes, processor: int) -> _Value:
    if len(body) < 2:
        return _Value([], [])
    kind, rank = struct.unpack_from("bB", body)
    shape = tuple(body[2 : 2 + rank])
    content = body[2 + rank :][: abs(kind) * math.prod(shape)]
    if kind == -1:
        width = shape[0] if shape else 1
        pieces = [content[i : i + width] for i in range(0, len(content), width)] if width else []
        return _Value([], [piece.decode("utf-8", "replace").strip(" \0") for piece in pieces])
    if kind not in (1, 2, 4):
        return _Value([], [])
    whole = content[: len(content) // kind * kind]
    if kind == 1:
        return _Value([float(v) for v in whole], [])
    if kind == 2:
        return _Value([float(v & 0xFFFF) for v in _words(whole, processor).tolist()], [])
    return _Value([float(v) for v in _floats(whole, processor)], [])


def _words(data: bytes, processor: int) -> NDArray[np.int16]:
    return np.frombuffer(data, ">i2" if processor == MIPS else "<i2")


def _floats(data: bytes, processor: int) -> NDArray[np.float32]:
    """Decode floats. processor: number format; DEC floats are IEEE times four with the two words
    exchanged.
    """
    if processor == DEC:
        swapped = np.frombuffer(data, "<u2").reshape(-1, 2)[:, ::-1].copy()
        return np.asarray(swapped.view("<f4")[:, 0] / 4, np.float32)
    return np.frombuffer(data, ">f4" if processor == MIPS else "<f4")


class _Layout(NamedTuple):
    """Layout of the frames: offset of the first, points and analog values per frame, number format, number of
    frames.
    """

    start: int
    points: int
    analogs: int
    floats: bool
    frames: int

    @property
    def frame_bytes(self) -> int:
        return (4 * self.points + self.analogs) * (4 if self.floats else 2)


def _layout(file: _File, assumed: list[str]) -> _Layout:
    """Return the stated layout that fits best: first by plausible points, then by an end near the
    file's end.
    """
    statements = _statements(file)
    choices = itertools.product(*(dict.fromkeys(stated + other) for stated, other in statements.values()))
    ranked = []
    for order, want in enumerate(itertools.starmap(_Layout, choices)):
        spare = len(file.data) - want.start
        want = want._replace(frames=_unwrapped(want.frames, spare, want.frame_bytes))
        if (there := min(want.frames, spare // want.frame_bytes)) > 0:
            rest = spare - want.frames * want.frame_bytes
            misfit = 0 if 0 <= rest < BLOCK else abs(rest)
            found = want._replace(frames=there)
            ranked.append((_implausible(file, found), misfit, order, want, found))
    if not ranked:
        raise FormatError("the C3D holds no whole frame of any marker; record again or copy it again")
    want, found = min(ranked)[3:]
    for (what, (stated, _)), used in zip(statements.items(), want, strict=True):
        if len(set(stated)) > 1:
            shown = " and ".join(str(value) for value in dict.fromkeys(stated))
            assumed.append(f"{what}: the file states {shown}; {used} fits and is used")
    with np.errstate(invalid="ignore"):  # a NaN that signals
        written = np.flatnonzero(_raw(file, found).any(axis=(1, 2)))
    if not len(written):
        raise FormatError("the file has no position in any frame; record again")
    found = found._replace(frames=int(written[-1]) + 1)
    if (stated := statements["frames"][0]) and want.frames not in stated:
        assumed.append(f"frames: the file states {stated[0]}, a count of 16 bits, and holds {found.frames}")
    elif found.frames < want.frames < _ALL:
        assumed.append(f"{want.frames - found.frames} of {want.frames} frames are missing at the file's end")
    return found


def _unwrapped(frames: int, spare: int, frame_bytes: int) -> int:
    """Return the number of frames from a 16-bit count: ezc3d writes 65535 for more, others drop multiples of
    65536.
    """
    there = spare // frame_bytes
    if frames == _MOST_16:
        return max(there, frames)
    full = frames + max(there - frames, 0) // (_MOST_16 + 1) * (_MOST_16 + 1)
    return full if spare - full * frame_bytes < BLOCK else frames


def _statements(file: _File) -> dict[str, tuple[list[int], list[int]]]:
    """Return for each field of ``_Layout`` the stated values, best first, and further possible values."""
    first, last, per_frame = (file.header_word(at) for at in (6, 8, 18))
    used, rates = file.numbers("ANALOG:USED"), file.numbers("ANALOG:RATE")
    point_rate = _usable_rate([*file.numbers("POINT:RATE"), file.header_float(20)])
    analogs = [u * round(r / point_rate) for u in used for r in rates[:2] if math.isfinite(r)]
    more_analogs = [u * per_frame for u in used] + used + [0]
    scales = [s for s in (*file.numbers("POINT:SCALE"), file.header_float(12)) if s]
    begin, end = (file.wide_number(f"TRIAL:ACTUAL_{which}_FIELD") for which in ("START", "END"))
    frames = [e - b + 1 for b, e in zip(begin, end, strict=False)] + [last - first + 1]
    frames += file.numbers("POINT:LONG_FRAMES") or file.numbers("POINT:FRAMES")
    starts = [BLOCK * (block - 1) for block in (file.header_word(16), *file.numbers("POINT:DATA_START"))]
    return {
        "start of the data": (_usable(starts, 1), [file.behind]),
        "points": (_usable([*file.numbers("POINT:USED"), file.header_word(2)], 1), []),
        "analog values a frame": (_usable([*analogs, file.header_word(4)], 0), _usable(more_analogs, 0)),
        "numbers as floats": ([s < 0 for s in scales], [True, False]),
        "frames": (_usable(frames, 1) or [_ALL], []),
    }


def _usable(values: Sequence[float], least: int) -> list[int]:
    whole = (int(value) for value in values if math.isfinite(value) and least <= value < _ALL)
    return list(dict.fromkeys(whole))[:_MOST_STATEMENTS]


def _raw(file: _File, layout: _Layout) -> NDArray[Any]:
    """Return a view (F, M, 4) of the points' numbers as stored; DEC floats are unsigned integers."""
    kind = ("u4" if file.processor == DEC else "f4") if layout.floats else "i2"
    dtype = np.dtype(kind).newbyteorder(">" if file.processor == MIPS else "<")
    shape, step = (layout.frames, layout.points, 4), dtype.itemsize
    return np.ndarray(shape, dtype, file.data, layout.start, (layout.frame_bytes, 4 * step, step))


def _decoded(raw: NDArray[Any]) -> NDArray[Any]:
    return _floats(raw.tobytes(), DEC).reshape(raw.shape) if raw.dtype.kind == "u" else raw


def _implausible(file: _File, layout: _Layout) -> bool:
    """Return whether too many points are impossible: by their residual, or by a coordinate out of range."""
    raw = _raw(file, layout)
    rows, columns = (np.unique(np.linspace(0, n - 1, SAMPLE).astype(int)) for n in raw.shape[:2])
    numbers = _decoded(raw[np.ix_(rows, columns)])
    with np.errstate(invalid="ignore"):
        numbers = numbers.astype(np.float64)
    place, residual = np.abs(numbers[..., :3]), numbers[..., 3]
    wrong = ~((residual == -1) | ((residual >= 0) & (residual <= 0xFFFF)))
    wrong |= ((place > 1e9) | ((place > 0) & (place < 1e-20))).any(axis=2)  # a kilometre in micrometres
    wrong &= np.isfinite(numbers).all(axis=2)
    return bool(wrong.mean() > IMPLAUSIBLE)


def _usable_rate(rates: list[float]) -> float:
    return next((rate for rate in rates if RATES[0] <= rate <= RATES[1]), math.inf)


def _rate(file: _File, assumed: list[str]) -> float:
    rates = [*file.numbers("POINT:RATE"), file.header_float(20)]
    rate = _usable_rate(rates)
    if not math.isfinite(rate):
        assumed.append(f"no rate is stated; {DEFAULT_RATE:g} frames a second are assumed")
        return DEFAULT_RATE
    if not all(math.isclose(other, rate, rel_tol=1e-3) for other in rates):
        shown = " and ".join(f"{value:g}" for value in dict.fromkeys(rates))
        assumed.append(f"frames a second: the file states {shown}; {rate:g} is used")
    return rate


def _scale(file: _File, assumed: list[str]) -> float:
    scales = [abs(s) for s in (*file.numbers("POINT:SCALE"), file.header_float(12))]
    scale = next((s for s in scales if s and math.isfinite(s)), 1.0)
    if not all(math.isclose(other, scale, rel_tol=1e-4) for other in scales):
        shown = " and ".join(f"{value:g}" for value in dict.fromkeys(scales))
        assumed.append(f"scale: the file states {shown}; {scale:g} is used where positions need one")
    return scale


def _labels(file: _File, points: int, assumed: list[str]) -> tuple[str, ...]:
    names = [name for more in ("", *"23456789") for name in file.texts(f"POINT:LABELS{more}")][:points]
    names += [""] * (points - len(names))
    if unnamed := names.count(""):
        assumed.append(f"{unnamed} of {points} points have no label and are named by their number, from 1")
    return tuple(name or str(number) for number, name in enumerate(names, 1))

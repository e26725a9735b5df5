"""C3D files from laboratories, including those whose header and parameters disagree.

After the parameters come, frame after frame, four numbers a point (x, y, z, residual) and the analog samples.
What the header and the parameters both state is compared; where they differ, the statement that fits the data
is used.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float64
from sensors.errors import FormatError
from synth.motion_files.c3d_parameters import BLOCK, DEC, MIPS, RATES, C3dFile, floats_of
from synth.motion_files.vertical_axis import AXES

IMPLAUSIBLE = 0.02
"""Share of points that cannot be any beyond which a layout is wrong. Measured on five recordings: 0 where
it is right, 0.11 to 0.3 where one analog value too many is counted."""
SAMPLE = 64
"""Frames, and points of each, that a layout is judged by. Untuned."""
DEFAULT_RATE = 100.0
"""Frames a second where none are stated: the commonest rate of motion capture."""
_ALL = 2**31
"""Frames where no number of them is stated: as many as there are."""
_MOST_16 = 0xFFFF
"""Largest count of 16 bits."""
_MOST_STATEMENTS = 4
"""Different values of one number that are tried. Untuned."""


class C3dPoints(NamedTuple):
    """Points of a C3D file: labels, M names; positions, float64 (F, M, 3) in its unit and axes, NaN where not
    seen; frames_per_second; unit, "" if none is stated; up, a direction of ``vertical.AXES`` or ""; assumed,
    one line each."""

    labels: tuple[str, ...]
    positions: Float64
    frames_per_second: float
    unit: str
    up: str
    assumed: tuple[str, ...]


def parse_c3d(data: bytes, most: int) -> C3dPoints:
    """Points of a C3D file's bytes.

    Raises FormatError when they are no C3D, or frames times points are none or more than ``most``.
    """
    if len(data) < BLOCK or data[1] != 0x50:
        raise FormatError("no C3D header; give a C3D file")
    assumed: list[str] = []
    file = C3dFile.of(data, assumed)
    layout = _layout(file, assumed)
    if layout.frames * layout.points > most:
        claim = f"{layout.frames} frames of {layout.points} points"
        raise FormatError(f"{claim} are over {most} positions; cut the recording")
    numbers, scale = _decoded(_raw(file, layout)), _scale(file, assumed)
    with np.errstate(invalid="ignore"):  # A NaN that signals.
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


class _Layout(NamedTuple):
    """How frames lie in the file: byte where they start, points and analog values a frame, whether numbers
    are floats or words, and how many frames there are."""

    start: int
    points: int
    analogs: int
    floats: bool
    frames: int

    @property
    def frame_bytes(self) -> int:
        return (4 * self.points + self.analogs) * (4 if self.floats else 2)


def _layout(file: C3dFile, assumed: list[str]) -> _Layout:
    """Layout that the data fit best, of all that header and parameters state; frames: those that are there.

    A layout is judged by whether its points can be any, then by how near to the file's end it ends.
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
    written = np.flatnonzero(_raw(file, found).any(axis=(1, 2)))
    if not len(written):
        raise FormatError("no position in any frame; record again")
    found = found._replace(frames=int(written[-1]) + 1)
    if (stated := statements["frames"][0]) and want.frames not in stated:
        assumed.append(f"frames: the file states {stated[0]}, a count of 16 bits, and holds {found.frames}")
    elif found.frames < want.frames < _ALL:
        assumed.append(f"{want.frames - found.frames} of {want.frames} frames are missing at the file's end")
    return found


def _unwrapped(frames: int, spare: int, frame_bytes: int) -> int:
    """Return the frames that a count of 16 bits stands for, where so many fill the ``spare`` bytes: ezc3d
    writes 65535 for more, others leave multiples of 65536 out."""
    there = spare // frame_bytes
    if frames == _MOST_16:
        return max(there, frames)
    full = frames + max(there - frames, 0) // (_MOST_16 + 1) * (_MOST_16 + 1)
    return full if spare - full * frame_bytes < BLOCK else frames


def _statements(file: C3dFile) -> dict[str, tuple[list[int], list[int]]]:
    """For each field of ``_Layout`` what the file states, best first, and what else may be meant."""
    first, last, per_frame = (file.header_word(at) for at in (6, 8, 18))
    used, rates = file.numbers("ANALOG:USED"), file.numbers("ANALOG:RATE")
    point_rate = _whole_rate([*file.numbers("POINT:RATE"), file.header_float(20)])
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
    """The first different whole numbers among ``values`` that can be a count or a place."""
    whole = (int(value) for value in values if math.isfinite(value) and least <= value < _ALL)
    return list(dict.fromkeys(whole))[:_MOST_STATEMENTS]


def _raw(file: C3dFile, layout: _Layout) -> NDArray[Any]:
    """View (F, M, 4) of the points' numbers as they are written; DEC's floats as unsigned integers."""
    kind = ("u4" if file.processor == DEC else "f4") if layout.floats else "i2"
    dtype = np.dtype(kind).newbyteorder(">" if file.processor == MIPS else "<")
    shape, step = (layout.frames, layout.points, 4), dtype.itemsize
    strides = (layout.frame_bytes, 4 * step, step)
    return np.ndarray(shape, dtype, file.data, layout.start, strides)


def _decoded(raw: NDArray[Any]) -> NDArray[Any]:
    """Numbers (F, M, 4) of what ``_raw`` shows."""
    return floats_of(raw.tobytes(), DEC).reshape(raw.shape) if raw.dtype.kind == "u" else raw


def _implausible(file: C3dFile, layout: _Layout) -> bool:
    """Whether too many of a layout's points cannot be any: their residual is no -1 and negative, or they are
    farther off than a kilometre in micrometres, or nearer than anybody measures."""
    raw = _raw(file, layout)
    rows, columns = (np.unique(np.linspace(0, n - 1, SAMPLE).astype(int)) for n in raw.shape[:2])
    numbers = _decoded(raw[np.ix_(rows, columns)])
    with np.errstate(invalid="ignore"):
        numbers = numbers.astype(np.float64)
    place, residual = np.abs(numbers[..., :3]), numbers[..., 3]
    wrong = ~((residual == -1) | ((residual >= 0) & (residual <= 0xFFFF)))
    wrong |= ((place > 1e9) | ((place > 0) & (place < 1e-20))).any(axis=2)
    wrong &= np.isfinite(numbers).all(axis=2)
    return bool(wrong.mean() > IMPLAUSIBLE)


def _whole_rate(rates: list[float]) -> float:
    return next((rate for rate in rates if RATES[0] <= rate <= RATES[1]), math.inf)


def _rate(file: C3dFile, assumed: list[str]) -> float:
    rates = [*file.numbers("POINT:RATE"), file.header_float(20)]
    rate = _whole_rate(rates)
    if not math.isfinite(rate):
        assumed.append(f"no rate is stated; {DEFAULT_RATE:g} frames a second are assumed")
        return DEFAULT_RATE
    if not all(math.isclose(other, rate, rel_tol=1e-3) for other in rates):
        shown = " and ".join(f"{value:g}" for value in dict.fromkeys(rates))
        assumed.append(f"frames a second: the file states {shown}; {rate:g} is used")
    return rate


def _scale(file: C3dFile, assumed: list[str]) -> float:
    """Factor of positions that are written as words."""
    scales = [abs(s) for s in (*file.numbers("POINT:SCALE"), file.header_float(12))]
    scale = next((s for s in scales if s and math.isfinite(s)), 1.0)
    if not all(math.isclose(other, scale, rel_tol=1e-4) for other in scales):
        shown = " and ".join(f"{value:g}" for value in dict.fromkeys(scales))
        assumed.append(f"scale: the file states {shown}; {scale:g} is used where positions need one")
    return scale


def _labels(file: C3dFile, points: int, assumed: list[str]) -> tuple[str, ...]:
    """Name of each point; a number from 1 where it has none."""
    names = [name for more in ("", *"23456789") for name in file.texts(f"POINT:LABELS{more}")][:points]
    names += [""] * (points - len(names))
    if unnamed := names.count(""):
        assumed.append(f"{unnamed} of {points} points have no label and are named by their number, from 1")
    return tuple(name or str(number) for number, name in enumerate(names, 1))

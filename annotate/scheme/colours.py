"""Distances of a scheme's colours for normal and colour-blind eyes, and proposals of colours."""

import itertools
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from annotate.array_types import Float64, UInt8
from annotate.scheme.scheme import BACKGROUND_PART, UNDEFINED_RGB, Part, Scheme
from sensors.errors import FormatError

TOUCHING_DISTANCE = 23.0  # CIE 1976, of neighbours and twins: the least of the paper's parts
BACKGROUND_DISTANCE = 35.0  # CIE 1976, of parts and the background: the least of the paper's parts
OTHER_DISTANCE = 3.0  # CIE 1976, of other pairs; 2.3 is just noticeable; 254 colours of the grid keep it
MARKS_RGB = ((255, 255, 0), (255, 0, 255), (0, 255, 255), (255, 255, 255))
MARK_DISTANCE = 10.0  # CIE 1976, of a mark's colour and all parts; untuned
PAGE_RGB = (255, 255, 255)  # of reports; no proposal is near it
GRID = 16  # proposed values of each channel: 4096 colours

EYES: dict[str, Float64] = {
    "normal": np.eye(3),
    "protan": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deutan": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "tritan": np.array(
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
        ]
    ),
}
"""Linear sRGB as seen without one kind of receptors (Machado, Oliveira & Fernandes 2009, severity 1)."""

_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
_KNEE = 6 / 29


@dataclass(frozen=True)
class NearPair:
    """Pair of parts whose colours are too near; the first may be the background.

    eyes: of EYES, where the distance (CIE 1976) is smallest. required: smallest allowed distance.
    """

    one: Part
    other: Part
    eyes: str
    distance: float
    required: float


def lab(rgb: ArrayLike) -> Float64:
    """Return L*a*b* (4, n, 3) of sRGB colours (n, 3), 8-bit values, for each of EYES.

    CIE 1976 L*a*b*; gamma and primaries of IEC 61966-2-1.
    """
    share = np.asarray(rgb, np.float64) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    seen = np.stack([np.clip(linear @ matrix.T, 0, 1) for matrix in EYES.values()])
    xyz = seen @ _XYZ.T / _XYZ.sum(axis=1)
    f = np.where(xyz > _KNEE**3, np.cbrt(xyz), xyz / (3 * _KNEE**2) + 4 / 29)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def required_distances(scheme: Scheme) -> Float64:
    """Return (n + 1, n + 1): the smallest allowed distance of the background and n parts; 0 on the diagonal.

    The background comes first.
    """
    at = {part.id: i for i, part in enumerate(scheme.parts, 1)}
    required = np.full((len(at) + 1, len(at) + 1), OTHER_DISTANCE)
    required[0] = required[:, 0] = BACKGROUND_DISTANCE
    for one, other in itertools.chain(scheme.twins, map(tuple, scheme.neighbours)):
        required[at[one], at[other]] = required[at[other], at[one]] = TOUCHING_DISTANCE
    np.fill_diagonal(required, 0)
    return required


def near_pairs(scheme: Scheme) -> Iterator[NearPair]:
    """Yield the pairs of parts whose colours are too near for some eyes, in order of the parts."""
    parts = (BACKGROUND_PART, *scheme.parts)
    seen, required = lab([part.rgb for part in parts]), required_distances(scheme)
    for i in range(1, len(parts)):
        distances = np.linalg.norm(seen[:, :i] - seen[:, i, None], axis=2)
        for j in np.flatnonzero(distances.min(axis=0) < required[i, :i]).tolist():
            eyes = int(distances[:, j].argmin())
            distance = float(distances[eyes, j])
            yield NearPair(parts[j], parts[i], [*EYES][eyes], distance, float(required[i, j]))


def with_proposed_colors(scheme: Scheme, without: Collection[int] = ()) -> Scheme:
    """Return the scheme with new colours for parts that have none or are too near an earlier part.

    without: ids of parts without a colour. Greedy and deterministic: parts with many neighbours come first;
    each takes the colour of the grid that is farthest from all others for the worst eyes. Raises FormatError
    where no colour of the grid is far enough from the neighbours.
    """
    parts = (BACKGROUND_PART, *scheme.parts)
    required = required_distances(scheme)
    kept = _kept(parts, without, required)
    if len(kept) == len(parts):
        return scheme
    grid_rgb, grid = _grid()
    # Rows: distances of the grid to each coloured part; the last: to undefined and the page.
    distances = np.full((len(parts) + 1, len(grid_rgb)), np.inf)
    required = np.pad(required, ((0, 0), (0, 1)))
    distances[kept] = [_distances(grid, lab([parts[i].rgb])) for i in kept]
    distances[-1] = np.minimum(*(_distances(grid, lab([rgb])) for rgb in (UNDEFINED_RGB, PAGE_RGB)))
    touching = (required == TOUCHING_DISTANCE).sum(axis=1)
    colored = list(parts)
    for i in sorted(set(range(len(parts))) - set(kept), key=lambda i: (-touching[i], i)):
        far = (distances >= required[i, :, None]).all(axis=0)
        if not far.any():
            raise FormatError(
                f"part {parts[i].name!r} has no colour far enough from its {touching[i]} neighbours "
                "and twins; state fewer neighbours, or remove the colours of some"
            )
        best = int(np.where(far, distances.min(axis=0), -1).argmax())
        red, green, blue = grid_rgb[best].tolist()
        colored[i] = replace(parts[i], rgb=(red, green, blue))
        distances[i] = _distances(grid, grid[:, best, None])
    return replace(scheme, parts=tuple(colored[1:]))


@cache
def mark_rgb(scheme: Scheme) -> tuple[int, int, int]:
    """Return the colour of marked pixels: the first of MARKS_RGB that no part is near, or the farthest."""
    seen = lab([part.rgb for part in scheme.parts])
    distances = [float(_distances(seen, lab([one])).min()) for one in MARKS_RGB]
    far = [one for one, distance in zip(MARKS_RGB, distances, strict=True) if distance >= MARK_DISTANCE]
    return far[0] if far else MARKS_RGB[int(np.argmax(distances))]


def _kept(parts: tuple[Part, ...], without: Collection[int], required: Float64) -> list[int]:
    """Return indices of parts with a colour that is far enough from all earlier kept colours."""
    seen, kept = lab([part.rgb for part in parts]), [0]
    for i in range(1, len(parts)):
        far = _distances(seen[:, kept], seen[:, i, None]) >= required[i, kept]
        if parts[i].id not in without and far.all():
            kept.append(i)
    return kept


def _distances(seen: Float64, one: Float64) -> Float64:
    """Return distances (n,) of colours (4, n, 3) to one (4, 1, 3), for the eyes with the smallest."""
    return np.asarray(np.linalg.norm(seen - one, axis=2).min(axis=0))


@cache
def _grid() -> tuple[UInt8, Float64]:
    """Return the proposed colours, uint8 (GRID ** 3, 3) and as ``lab``."""
    values = np.linspace(0, 255, GRID).round().astype(np.uint8)
    rgb = np.array([*itertools.product(values, repeat=3)], np.uint8)
    return rgb, lab(rgb)

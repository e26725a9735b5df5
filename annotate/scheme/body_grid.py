"""Grid of a scheme's parts, arranged like a body that faces the user: the right arm is at the left.

Twins are in the outer columns, other parts in the middle, all by their height on the body. The background has
the last place, and things have a grid of their own.
"""

from collections.abc import Sequence
from functools import cache
from itertools import combinations

from annotate.scheme.regions import Region
from annotate.scheme.scheme import BACKGROUND, Part, Scheme

COLUMNS = 3
Grid = tuple[tuple[int | None, ...], ...]
"""Rows of part ids for the person's right, middle and left; None is an empty place."""

_HEIGHTS = {
    "head": 0.93,
    "neck": 0.86,
    "shoulder": 0.83,
    "chest": 0.75,
    "upper_arm": 0.72,
    "belly": 0.65,
    "lower_belly": 0.58,
    "forearm": 0.55,
    "hip": 0.53,
    "hand": 0.46,
    "fingers": 0.42,
    "upper_leg": 0.38,
    "lower_leg": 0.17,
    "foot": 0.03,
    "toes": 0.01,
}
"""Heights of regions on a standing body with hanging arms, as shares of its stature."""


@cache
def body_grid(scheme: Scheme) -> Grid:
    """Return the grid of the background and all parts of the body.

    Without left and right, parts fill rows of three from the head down.
    """
    body = sorted((part for part in scheme.parts if not part.is_free), key=_rank)
    rows = _with_sides(scheme, body)
    if rows is None:
        rows = [*_chunks([part.id for part in body])]
        if rows[-1][1] is not None:
            rows.append((None, None, None))
        rows[-1] = (rows[-1][0], BACKGROUND, None)
    return tuple(rows)


@cache
def thing_grid(scheme: Scheme) -> Grid:
    """Return the grid of the things: pairs of left and right first."""
    things = [part.id for part in scheme.parts if part.is_free]
    pairs = [(left, right) for left, right in scheme.twins if left in things]
    alone = [one for one in things if scheme.twin_table[one] == one]
    middle = [*alone[: len(pairs)], *[None] * (len(pairs) - len(alone))]
    rows = [(right, one, left) for (left, right), one in zip(pairs, middle, strict=True)]
    return (*rows, *_chunks(alone[len(pairs) :]))


def _with_sides(scheme: Scheme, body: Sequence[Part]) -> list[tuple[int | None, ...]] | None:
    """Return rows of sorted parts, None for a scheme without left and right parts of the body."""
    by_left = dict(scheme.twins)
    left = [part for part in body if part.id in by_left]
    middle = [part for part in body if scheme.twin_table[part.id] == part.id]
    if not left:
        return None
    count = max(len(left), len(middle) + 1)
    if len(left) == count:
        at_left, at_middle = [*range(count)], _places(middle, [_height(part) for part in left[:-1]])
    else:
        at_middle = [*range(len(middle))]
        at_left = _places(left, [*map(_height, middle), *[0.0] * (count - len(middle))])
    rows: list[list[int | None]] = [[None] * COLUMNS for _ in range(count)]
    for row, part in zip(at_left, left, strict=True):
        rows[row][0], rows[row][2] = by_left[part.id], part.id
    for row, part in zip(at_middle, middle, strict=True):
        rows[row][1] = part.id
    rows[-1][1] = BACKGROUND
    return [tuple(row) for row in rows]


def _places(parts: Sequence[Part], rows: Sequence[float]) -> list[int]:
    """Return increasing rows for sorted parts, as near to their heights as possible. rows: heights."""
    heights = [_height(part) for part in parts]
    return list(
        min(
            combinations(range(len(rows)), len(parts)),
            key=lambda places: sum(abs(rows[i] - height) for i, height in zip(places, heights, strict=True)),
        )
    )


def _chunks(ids: Sequence[int]) -> list[tuple[int | None, ...]]:
    padded = [*ids, *[None] * (-len(ids) % COLUMNS)]
    return [tuple(padded[i : i + COLUMNS]) for i in range(0, len(padded), COLUMNS)]


def _rank(part: Part) -> tuple[float, int]:
    return -_height(part), part.id


def _height(part: Part) -> float:
    return sum(map(_region_height, part.regions)) / len(part.regions)


def _region_height(region: Region) -> float:
    label = region.label
    return _HEIGHTS.get(label) or _HEIGHTS[label.split("_", 1)[-1]]

"""Scheme: the parts of label images. A part is a union of regions of the body, or a thing beside the body."""

import itertools
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from annotate.array_types import Bool, Int64, UInt8
from annotate.scheme.regions import REGION_NEIGHBOURS, Region

BACKGROUND, UNDEFINED = 0, 255
MAX_PARTS = 254  # ids 1 to 254 of 8-bit label images; 0 and 255 are background and undefined

IdPair = frozenset[int]
_SIDE = re.compile(r"\b(?:left|right)\b", re.IGNORECASE)


@dataclass(frozen=True)
class Part:
    """Part of a scheme. A thing (``is_free``) has no regions.

    id: 1 to 254, the value in label images. name: in files. title: for people. rgb: 8-bit sRGB. key: in the
    correction window, or "".
    """

    id: int
    name: str
    title: str
    rgb: tuple[int, int, int]
    key: str = ""
    regions: frozenset[Region] = frozenset()

    @property
    def is_free(self) -> bool:
        """Return whether the part is a thing and no part of the body."""
        return not self.regions

    @property
    def mirrored(self) -> frozenset[Region]:
        """Return the regions on the other side; regions in the middle stay."""
        return frozenset(region.twin for region in self.regions)


BACKGROUND_PART = Part(BACKGROUND, "background", "Background", (24, 24, 28), "X")
UNDEFINED_RGB = (128, 128, 128)  # 8-bit sRGB of undefined pixels in pictures


@dataclass(frozen=True)
class Scheme:
    """Scheme of parts, sorted by id; the background is in every scheme and not in ``parts``.

    twins: pairs of ids, left and right. neighbours: pairs of ids of parts that touch. ``scheme_of`` derives
    twins and neighbours from regions.
    """

    name: str
    parts: tuple[Part, ...]
    twins: tuple[tuple[int, int], ...]
    neighbours: frozenset[IdPair]

    background: ClassVar[int] = BACKGROUND
    undefined: ClassVar[int] = UNDEFINED

    @cached_property
    def part_id(self) -> dict[str, int]:
        """Return ids by name, the background's included."""
        return {part.name: part.id for part in (BACKGROUND_PART, *self.parts)}

    @cached_property
    def by_id(self) -> dict[int, Part]:
        """Return parts by id, the background included."""
        return {part.id: part for part in (BACKGROUND_PART, *self.parts)}

    def title(self, part_id: int) -> str:
        """Return a part's title for use in sentences, in lower case; "undefined" for 255."""
        return "undefined" if part_id == UNDEFINED else self.by_id[part_id].title.lower()

    def short_title(self, part_id: int) -> str:
        """Return a part's title in a list with two sides: of a part with a twin, without the side."""
        title = self.by_id[part_id].title
        if self.twin_table[part_id] != part_id:
            title = " ".join(_SIDE.sub("", title).split()) or title
        return title.capitalize()

    @cached_property
    def n_classes(self) -> int:
        """Return the length of an array indexed by part id: the highest id and the background."""
        return 1 + max((part.id for part in self.parts), default=0)

    @cached_property
    def class_ids(self) -> UInt8:
        """Return the ids (k,) of a network's classes in order: the background, then the parts by id."""
        return np.array([BACKGROUND, *(part.id for part in self.parts)], np.uint8)

    @cached_property
    def class_table(self) -> UInt8:
        """Return uint8 (256,): a network's class by id; undefined and unused ids become 255."""
        table = np.full(256, UNDEFINED, np.uint8)
        table[self.class_ids] = np.arange(len(self.class_ids))
        return table

    @cached_property
    def twin_classes(self) -> UInt8:
        """Return uint8 (k,): the class on the other side, by class."""
        return self.class_table[self.twin_table[self.class_ids]]

    @cached_property
    def body_classes(self) -> Int64:
        """Return the sorted classes (n,) of the parts of the body."""
        return np.flatnonzero([False, *(not part.is_free for part in self.parts)])

    @cached_property
    def is_of_regions(self) -> bool:
        """Return whether each part is one region and no part is a thing."""
        return all(len(part.regions) == 1 for part in self.parts)

    def ids_of(self, regions: Iterable[Region]) -> tuple[int, ...]:
        """Return the sorted ids of the parts that hold a region of ``regions``."""
        return tuple(sorted({int(self.table[region]) for region in regions}))

    @cached_property
    def is_label(self) -> Bool:
        """Return flags (256,) by id: True for parts, background and undefined."""
        return self._flags([BACKGROUND, UNDEFINED, *(part.id for part in self.parts)])

    @cached_property
    def is_thing(self) -> Bool:
        """Return flags (256,) by id: True for things."""
        return self._flags([part.id for part in self.parts if part.is_free])

    @cached_property
    def things(self) -> frozenset[str]:
        """Return the names of the things."""
        return frozenset(part.name for part in self.parts if part.is_free)

    def _flags(self, ids: list[int]) -> Bool:
        flags = np.zeros(256, np.bool_)
        flags[ids] = True
        return flags

    @cached_property
    def label_text(self) -> str:
        """Return the allowed ids of label images for messages, such as "0 to 11, or 255 for undefined"."""
        ids = [i for i in range(UNDEFINED) if self.is_label[i]]
        starts = [i for i in ids if i - 1 not in ids]
        ends = [i for i in ids if i + 1 not in ids]
        ranges = [
            f"{one} to {other}" if one < other else f"{one}" for one, other in zip(starts, ends, strict=True)
        ]
        return f"{', '.join(ranges)}, or {UNDEFINED} for undefined"

    def unknown_ids(self, labels: UInt8) -> Int64:
        """Return the sorted ids of labels (any shape) that this scheme lacks."""
        if self.is_label[: int(labels.max(initial=0)) + 1].all():
            return np.empty(0, np.int64)
        return np.flatnonzero((np.bincount(labels.ravel(), minlength=256) > 0) & ~self.is_label)

    def on_body(self, labels: UInt8) -> Bool:
        """Return flags, True where a label (any shape) is a part of the body; things are not."""
        return np.asarray(self.on_person(labels) & (labels != UNDEFINED))

    def on_part(self, labels: UInt8) -> Bool:
        """Return flags, True where a label (any shape) is a part, of the body or a thing."""
        return np.asarray((labels != BACKGROUND) & (labels != UNDEFINED))

    def on_person(self, labels: UInt8) -> Bool:
        """Return flags, True where a label (any shape) is a part of the body or undefined."""
        # Comparisons take a tenth of the time of a table.
        on_something = np.asarray(labels != BACKGROUND)
        return on_something & ~self.is_thing[labels] if self.is_thing.any() else on_something

    @cached_property
    def table(self) -> UInt8:
        """Return part ids uint8 (256,) by region id.

        0 is background; ids without a region become undefined.
        """
        table = np.full(256, UNDEFINED, np.uint8)
        table[BACKGROUND] = BACKGROUND
        for part in self.parts:
            table[list(part.regions)] = part.id
        return table

    @cached_property
    def twin_table(self) -> UInt8:
        """Return uint8 (256,): the id on the other side, by id; a part in the middle is its own twin."""
        table = np.arange(256, dtype=np.uint8)
        for left, right in self.twins:
            table[left], table[right] = right, left
        return table

    def swap_left_right(self, labels: UInt8) -> UInt8:
        """Exchange left and right parts in labels uint8 of any shape."""
        return self.twin_table[labels]

    def palette_rgb(self) -> UInt8:
        """Return colours uint8 (256, 3) by id; undefined is grey, unused ids black."""
        palette = np.zeros((256, 3), np.uint8)
        for part in (BACKGROUND_PART, *self.parts):
            palette[part.id] = part.rgb
        palette[UNDEFINED] = UNDEFINED_RGB
        return palette


def scheme_of(
    name: str,
    parts: Iterable[Part],
    twins: Iterable[tuple[int, int]] = (),
    neighbours: Iterable[IdPair] = (),
) -> Scheme:
    """Return the scheme of parts with distinct ids.

    twins, neighbours: pairs of ids to add to the pairs that follow from regions, such as pairs of things.
    """
    by_id = tuple(sorted(parts, key=lambda part: part.id))
    all_twins = sorted({*derived_twins(by_id), *twins})
    return Scheme(name, by_id, tuple(all_twins), derived_neighbours(by_id) | frozenset(neighbours))


def derived_twins(parts: Iterable[Part]) -> tuple[tuple[int, int], ...]:
    """Return pairs of ids, left and right, of parts whose regions mirror each other."""
    body = [part for part in parts if not part.is_free]
    by_regions = {part.regions: part for part in body}
    pairs = set[tuple[int, int]]()
    for part in body:
        twin = by_regions.get(part.mirrored)
        if twin is not None and twin.id != part.id:
            left, right = sorted((part, twin), key=lambda one: (side_of(one), one.id))
            pairs.add((left.id, right.id))
    return tuple(sorted(pairs))


def side_of(part: Part) -> int:
    """Return regions on the right minus regions on the left: below 0 is a part of the left side."""
    labels = [region.label for region in part.regions]
    return sum(one.startswith("right_") - one.startswith("left_") for one in labels)


def derived_neighbours(parts: Iterable[Part]) -> frozenset[IdPair]:
    """Return pairs of ids of parts with neighbouring regions."""
    touching = {pair for one in REGION_NEIGHBOURS for pair in itertools.permutations(one)}
    return frozenset(
        frozenset((one.id, other.id))
        for one, other in itertools.combinations(parts, 2)
        if not touching.isdisjoint(itertools.product(one.regions, other.regions))
    )

"""Conversion of labels from one scheme to another, and the finest scheme that two schemes share."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from annotate.array_types import Float32, UInt8
from annotate.scheme.colours import with_proposed_colors
from annotate.scheme.regions import Region
from annotate.scheme.scheme import BACKGROUND, UNDEFINED, Part, Scheme, scheme_of
from annotate.scheme.scheme_file import SHIPPED, load_scheme
from sensors.errors import FormatError

_MAX_NAME = 64  # characters of a joined name, the limit of scheme files

Regions = frozenset[Region]


@dataclass(frozen=True)
class CommonScheme:
    """Finest scheme into which the labels of two schemes convert.

    from_first, from_second: uint8 (256,), the common part id by a scheme's own id.
    """

    scheme: Scheme
    from_first: UInt8
    from_second: UInt8


def converts(source: Scheme, target: Scheme) -> bool:
    """Return whether every body part of ``source`` is within one part of ``target``."""
    return not _split_parts(source, target)


def conversion_table(source: Scheme, target: Scheme) -> UInt8:
    """Return uint8 (256,): the id in ``target`` by the id in ``source``; unused ids become undefined.

    A thing becomes the thing of its name, or background where ``target`` has none. Raises FormatError
    where a part of ``source`` would be split.
    """
    for part in _split_parts(source, target):
        names = ", ".join(one.name for one in target.parts if one.regions & part.regions)
        raise FormatError(
            f"part {part.name!r} of scheme {source.name!r} lies in several parts of scheme {target.name!r} "
            f"({names}); choose a coarser scheme"
        )
    things = {part.name: part.id for part in target.parts if part.is_free}
    table = np.full(256, UNDEFINED, np.uint8)
    table[BACKGROUND] = BACKGROUND
    for part in source.parts:
        table[part.id] = (
            things.get(part.name, BACKGROUND) if part.is_free else target.table[min(part.regions)]
        )
    return table


def class_sums(planes: Float32, source: Scheme, target: Scheme) -> Float32:
    """Return class probabilities (k, ...) of ``target`` from (k', ...) of ``source``: sums, by class.

    Further planes after the classes of ``source``, such as another person, follow unchanged. Raises
    FormatError where a part of ``source`` would be split.
    """
    conversion_table(source, target)
    return class_shares(planes, source, target)


def class_shares(planes: Float32, source: Scheme, target: Scheme) -> Float32:
    """Return ``class_sums``, where a part of ``source`` that lies in several parts of ``target`` gives each
    an equal share.
    """
    things = {part.name: part.id for part in target.parts if part.is_free}
    sums = np.zeros((len(target.class_ids), *planes.shape[1:]), np.float32)
    sums[BACKGROUND] = planes[BACKGROUND]
    for plane, part in zip(planes[1:], source.parts, strict=False):
        into = target.ids_of(part.regions) or (things.get(part.name, BACKGROUND),)
        for part_id in into:
            sums[target.class_table[part_id]] += plane / np.float32(len(into))
    return np.concatenate([sums, planes[len(source.class_ids) :]])


def _split_parts(source: Scheme, target: Scheme) -> list[Part]:
    """Return the body parts of ``source`` that lie in several parts of ``target``."""
    body = [part for part in source.parts if not part.is_free]
    return [part for part in body if len(set(target.table[list(part.regions)].tolist())) > 1]


def finest_common(first: Scheme, second: Scheme) -> CommonScheme:
    """Return the finest scheme that both schemes convert into; the order of the two does not matter.

    Body parts that overlap are joined; things stay where both schemes have the name. Parts of the scheme
    with fewer parts keep id, name, colour and key; joined parts have a shipped scheme's name, if any.
    """
    one, other = sorted((first, second), key=lambda scheme: (len(scheme.parts), scheme.name))
    classes = joined_classes(part.regions for part in (*one.parts, *other.parts) if not part.is_free)
    free = one.things & other.things
    common = next((scheme for scheme in (one, other) if _is_made_of(scheme, classes, free)), None)
    if common is None:
        common = _scheme(one, other, classes, free)
    return CommonScheme(common, conversion_table(first, common), conversion_table(second, common))


def joined_classes(sets: Iterable[Regions]) -> list[Regions]:
    """Return the unions of overlapping sets, sorted by their first region."""
    classes = list[Regions]()
    for regions in sets:
        apart = [one for one in classes if one.isdisjoint(regions)]
        classes = [*apart, regions.union(*(one for one in classes if one not in apart))]
    return sorted(classes, key=min)


def _is_made_of(scheme: Scheme, classes: list[Regions], free: frozenset[str]) -> bool:
    body = {part.regions for part in scheme.parts if not part.is_free}
    return body == set(classes) and scheme.things == free


def _scheme(one: Scheme, other: Scheme, classes: list[Regions], free: frozenset[str]) -> Scheme:
    """Return a new scheme of classes of regions and names of things."""
    kept = [part for part in one.parts if part.regions in classes or (part.is_free and part.name in free)]
    own = {part.regions: part for part in other.parts}
    parts, here = list(kept), {part.regions for part in kept}
    for regions in classes:
        if regions not in here:
            parts.append(_unlike(parts, own.get(regions) or _joined(one, regions)))
    by_name = {part.name: part.id for part in parts}
    names = {part.id: part.name for part in one.parts}

    def pairs(stated: Iterable[Iterable[int]]) -> list[tuple[int, ...]]:
        """Return the pairs of ids of ``one`` whose parts are free and stay, in ids of the new scheme."""
        wanted = [tuple(names[i] for i in pair) for pair in stated]
        return [tuple(by_name[name] for name in pair) for pair in wanted if free.issuperset(pair)]

    twins = [(left, right) for left, right in pairs(one.twins)]
    neighbours = [frozenset(pair) for pair in pairs(one.neighbours)]
    return with_proposed_colors(scheme_of(f"{one.name}-{other.name}"[:_MAX_NAME], parts, twins, neighbours))


def _joined(scheme: Scheme, regions: Regions) -> Part:
    """Return the joined part with id, colour and key of its first part in ``scheme``.

    Its name and title are a shipped scheme's, or list the joined parts.
    """
    within = [part for part in scheme.parts if part.regions and part.regions <= regions]
    for shipped in SHIPPED:
        for part in load_scheme(shipped).parts:
            if part.regions == regions:
                return replace(within[0], name=part.name, title=part.title, regions=regions)
    name = "_and_".join(part.name for part in within)
    title = " and ".join((within[0].title, *(part.title.lower() for part in within[1:])))
    if len(name) > _MAX_NAME:
        name, title = f"{within[0].name[:40]}_and_{len(within) - 1}_parts", f"{within[0].title} and others"
    return replace(within[0], name=name, title=title, regions=regions)


def _unlike(parts: list[Part], part: Part) -> Part:
    """Return the part with an id, a name and a key that no other part has."""
    ids, names, keys = ({getattr(one, field) for one in parts} for field in ("id", "name", "key"))
    number = next(i for i in (part.id, *range(1, 255)) if i not in ids)
    endings = ("", *(f"_{i}" for i in range(2, 256)))
    name = next(one for one in (f"{part.name[:60]}{ending}" for ending in endings) if one not in names)
    return replace(part, id=number, name=name, key="" if part.key in keys else part.key)

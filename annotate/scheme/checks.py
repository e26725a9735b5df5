"""Checks of ids, names, keys, regions, twins and colours; each fault is one line with its remedy."""

import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Iterator

from annotate.scheme.colours import near_pairs
from annotate.scheme.regions import Region
from annotate.scheme.scheme import BACKGROUND_PART, MAX_PARTS, UNDEFINED, IdPair, Part, Scheme, side_of

RESERVED_NAMES = (BACKGROUND_PART.name, "undefined")


def identity_faults(parts: tuple[Part, ...]) -> Iterator[str]:
    """Yield faults of ids, names and keys."""
    for part in parts:
        if not 1 <= part.id <= MAX_PARTS:
            yield (
                f"part {part.name!r} has id {part.id}; give 1 to {MAX_PARTS}, "
                f"because 0 is background and {UNDEFINED} undefined"
            )
        if part.name in RESERVED_NAMES:
            yield f"a part has the name {part.name!r}, which every scheme has already; rename the part"
        if part.key.upper() == BACKGROUND_PART.key:
            yield f"part {part.name!r} has the key of the background, {part.key!r}; give another key"
    yield from _repeated("name", parts, lambda part: part.name)
    yield from _repeated("id", parts, lambda part: part.id)
    yield from _repeated("key", filter(lambda part: part.key, parts), lambda part: part.key.upper())


def _repeated(what: str, parts: Iterable[Part], value: Callable[[Part], object]) -> Iterator[str]:
    parts = list(parts)
    for one, times in Counter(map(value, parts)).items():
        if times > 1:
            names = " and ".join(repr(part.name) for part in parts if value(part) == one)
            yield f"parts {names} have the same {what} {one!r}; give each its own"


def region_faults(parts: tuple[Part, ...]) -> Iterator[str]:
    """Yield faults of regions: in two parts, in no part, on the wrong side, without a mirror image."""
    for region in Region:
        owners = [repr(part.name) for part in parts if region in part.regions]
        if len(owners) > 1:
            yield f"region {region.label} is in parts {' and '.join(owners)}; leave it in one of them"
    if absent := set(Region).difference(*(part.regions for part in parts)):
        yield f"regions in no part: {_listed(absent)}; add them to the regions of parts"
    for part in parts:
        words, side = set(part.name.split("_")), side_of(part)
        for name, is_other in (("left", side > 0), ("right", side < 0)):
            if name in words and is_other:
                yield f"part {part.name!r} has {_listed(part.regions)}; give it regions of the {name} side"
    sets = {part.regions for part in parts}
    for part in parts:
        if part.mirrored not in sets:
            yield (
                f"part {part.name!r} has no twin; give one part exactly the mirrored regions: "
                f"{_listed(part.mirrored)}"
            )


def _listed(regions: Iterable[Region]) -> str:
    return ", ".join(region.label for region in sorted(regions))


def pair_faults(
    parts: tuple[Part, ...], twins: Iterable[tuple[int, int]], neighbours: Iterable[IdPair]
) -> Iterator[str]:
    """Yield faults of twins and neighbours that a file states beside the pairs that follow from regions."""
    by_id = {part.id: part for part in parts}
    twins = list(twins)
    for part_id, times in Counter(one for pair in twins for one in pair).items():
        part = by_id[part_id]
        if times > 1:
            yield f"twins have part {part.name!r} {times} times; name it once"
        if not part.is_free:
            yield f"twins have part {part.name!r}, whose twin follows from its regions; remove that pair"
    for pair in neighbours:
        if len(pair) == 1:
            yield f"neighbours have part {by_id[min(pair)].name!r} beside itself; name two parts"


def color_faults(scheme: Scheme, where: str) -> Iterator[str]:
    """Yield messages on equal colours, and on colours too similar for some eyes. where: the scheme's file."""
    remedy = f"run annotate-cloud scheme colours {shlex.quote(where)}"
    for pair in near_pairs(scheme):
        one = "the background" if pair.one == BACKGROUND_PART else repr(pair.one.name)
        if pair.one.rgb == pair.other.rgb:
            color = "#{:02x}{:02x}{:02x}".format(*pair.one.rgb)
            yield f"{one} and {pair.other.name!r} have the same colour {color}; {remedy}"
        else:
            yield (
                f"{one} and {pair.other.name!r} are {pair.distance:.1f} apart in colour for {pair.eyes} "
                f"eyes (CIE 1976; at least {pair.required:g}); {remedy}"
            )

"""Limbs of a scheme: parts of both sides whose left and right are exchanged together."""

from dataclasses import dataclass
from functools import cache

from annotate.scheme.regions import Region
from annotate.scheme.scheme import Scheme

_ARM = frozenset(
    r for r in Region if r.label.split("_", 1)[-1] in ("upper_arm", "forearm", "hand", "fingers")
)
_LEG = frozenset(r for r in Region if r.label.split("_", 1)[-1] in ("upper_leg", "lower_leg", "foot", "toes"))


@dataclass(frozen=True)
class Limb:
    """Connected parts with a left and a right: arms, legs, or the wheels of a wheelchair.

    singular, plural: names for sentences. pairs: ids of left and right parts.
    """

    singular: str
    plural: str
    pairs: tuple[tuple[int, int], ...]

    @property
    def ids(self) -> frozenset[int]:
        """Return the ids of both sides."""
        return frozenset(one for pair in self.pairs for one in pair)


@cache
def limbs_of(scheme: Scheme) -> tuple[Limb, ...]:
    """Return the limbs of a scheme in the order of its twins: groups of twins that are neighbours.

    Parts of the body and things are never in one limb.
    """
    groups = list[list[tuple[int, int]]]()
    for pair in scheme.twins:
        touching = [group for group in groups if any(_joined(scheme, pair, other) for other in group)]
        groups = [group for group in groups if group not in touching]
        groups.append([*(other for group in touching for other in group), pair])
    return tuple(_limb(scheme, tuple(sorted(group))) for group in sorted(groups, key=min))


def limb_names(scheme: Scheme) -> str:
    """Return the names of the limbs for a sentence, such as "an arm or a leg"."""
    return " or ".join(limb.singular for limb in limbs_of(scheme)) or "a part with two sides"


def _joined(scheme: Scheme, pair: tuple[int, int], other: tuple[int, int]) -> bool:
    (left, right), (other_left, other_right) = pair, other
    beside = {frozenset((left, other_left)), frozenset((right, other_right))} & scheme.neighbours
    return bool(beside) and bool(scheme.is_thing[left] == scheme.is_thing[other_left])


def _limb(scheme: Scheme, pairs: tuple[tuple[int, int], ...]) -> Limb:
    """Return the limb of pairs, with a name by its regions."""
    regions = frozenset(region for pair in pairs for one in pair for region in scheme.by_id[one].regions)
    if regions & _ARM and not regions & _LEG:
        return Limb("an arm", "arms", pairs)
    if regions & _LEG and not regions & _ARM:
        return Limb("a leg", "legs", pairs)
    names = list(dict.fromkeys(scheme.short_title(left).lower() for left, _ in pairs))
    return Limb(f"one side of {' and '.join(names)}", " and ".join(names), pairs)

"""Kinds of a scheme's classes, which a network scores without their side."""

from dataclasses import dataclass

from annotate.scheme.scheme import Scheme


@dataclass(frozen=True)
class Kinds:
    """Kinds of a scheme's classes: a kind is a class without its side, e.g. an arm.

    of_class: (K,), the kind of each class. sides: (K,), 1 for left, -1 for right, 0 for a class in the
    middle.
    """

    of_class: tuple[int, ...]
    sides: tuple[int, ...]

    @classmethod
    def of(cls, scheme: Scheme) -> "Kinds":
        """Return the kinds of a scheme's classes, in order of their first class."""
        first = [min(i, twin) for i, twin in enumerate(scheme.twin_classes.tolist())]
        order = sorted(set(first))
        sides = [0] * len(first)
        for left, right in scheme.twins:
            sides[scheme.class_table[left]], sides[scheme.class_table[right]] = 1, -1
        return cls(tuple(order.index(i) for i in first), tuple(sides))

    def __len__(self) -> int:
        return 1 + max(self.of_class)

"""Classes of a network, and their probabilities in another scheme."""

from typing import Self

import numpy as np

from annotate.array_types import Float32, UInt8
from annotate.scheme.merging import class_shares, conversion_table, converts
from annotate.scheme.scheme import Scheme
from annotate.scheme.scheme_file import load_scheme


class SchemeNetwork:
    """Base of networks whose classes are the background, then the parts of a scheme by id.

    own: scheme of the network's classes. scheme: of the labels, ``own`` or by ``in_scheme``.
    """

    own: Scheme
    scheme: Scheme

    @property
    def usual_scheme(self) -> Scheme:
        """Return the scheme of labels by default: ``scheme``, ``paper`` for a network of regions."""
        return load_scheme("paper") if self.scheme.is_of_regions else self.scheme

    def in_scheme(self, scheme: Scheme) -> Self:
        """Return the network with labels in a scheme: each part has the summed probability of its classes.

        Raises FormatError where a class would be split.
        """
        conversion_table(self.own, scheme)
        return self.labelling(scheme)

    def labelling(self, scheme: Scheme) -> Self:
        """Return the network as ``in_scheme``, but a class that is split gives each part an equal share."""
        converted = object.__new__(type(self))  # without loading the weights again
        vars(converted).update(vars(self) | {"scheme": scheme})
        return converted

    @property
    def divides(self) -> bool:
        """Return whether a class of ``own`` lies in several parts of ``scheme``."""
        return not converts(self.own, self.scheme)

    def undivided(self, planes: Float32, classes: UInt8) -> Float32:
        """Return probabilities (...) of classes (...) of ``scheme``, summed over the parts of an own class.

        planes: (k, ...), probabilities in ``scheme``, equal among the parts of a divided class.
        """
        total = np.zeros(classes.shape, np.float32)
        for number, part in enumerate(self.scheme.parts, 1):
            regions = {r for own in self.own.parts if own.regions & part.regions for r in own.regions}
            kin = self.scheme.class_table[list(self.scheme.ids_of(regions))] if regions else [number]
            here = classes == number
            total[here] = planes[:, here][kin].sum(axis=0)
        return total

    def merged(self, planes: Float32) -> Float32:
        """Return probabilities (k, ...) of the classes of ``scheme`` from (k', ...) of ``own``."""
        return planes if self.scheme == self.own else class_shares(planes, self.own, self.scheme)

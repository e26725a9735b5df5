"""Classes of a network, and their probabilities in another scheme."""

from typing import Self

from annotate.array_types import Float32
from annotate.scheme.merging import class_shares, conversion_table
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

    def merged(self, planes: Float32) -> Float32:
        """Return probabilities (k, ...) of the classes of ``scheme`` from (k', ...) of ``own``."""
        return planes if self.scheme == self.own else class_shares(planes, self.own, self.scheme)

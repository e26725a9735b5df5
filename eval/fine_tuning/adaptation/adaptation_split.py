"""Crops of an adaptation: labelled people, taught and held out, and synthetic ones that are rehearsed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from annotate.array_types import Bool, Int64
from eval.fine_tuning.adaptation.labelled_people import LabelledPerson
from eval.training.crops import UNKNOWN, Crops
from sensors.errors import CloudError

SPANS = 12  # equal spans of a recording; neighbouring frames show one picture; untuned
EACH = 4  # number of people, recordings or spans of which one is held out; untuned
LEAST_SPANS = 3  # that are held out, because an interval of fewer is endless


@dataclass(frozen=True)
class AdaptationSplit:
    """Crops of labelled and of synthetic people.

    taught, held: indices of labelled people. span_of: (len(held),), number of each one's span, from 0.
    rehearsed, checked: indices of synthetic people. held_out: "people", "recordings" or "spans".
    """

    crops: Crops
    taught: Int64
    held: Int64
    span_of: Int64
    rehearsed: Int64
    checked: Int64
    held_out: str

    @property
    def trained(self) -> Int64:
        """Return the indices of the crops to train on."""
        return np.concatenate([self.taught, self.rehearsed])

    @property
    def left_out(self) -> Crops:
        """Return the crops that are not trained on."""
        return self.crops.chosen(np.concatenate([self.held, self.checked]))


@dataclass(frozen=True)
class HeldOut:
    """People who are held out. mask: (n,), of labelled people. span_of: (mask.sum(),), as in the split.

    kind: "people", "recordings" or "spans".
    """

    mask: Bool
    span_of: Int64
    kind: str

    @classmethod
    def of(cls, people: Sequence[LabelledPerson]) -> Self:
        """Hold out one of ``EACH`` people, of fewer people one of ``EACH`` recordings, of fewer recordings
        one of ``EACH`` spans.

        Raises CloudError where fewer than ``LEAST_SPANS`` spans are held out.
        """
        mask, kind = _chosen(people)
        keys = [(one.recording, one.bodies, span(one)) for one, out in zip(people, mask, strict=True) if out]
        known = list(dict.fromkeys(keys))
        if len(known) < LEAST_SPANS or mask.all():
            raise CloudError(
                f"{len(people)} labelled people are too few to hold some out; label at least "
                f"{LEAST_SPANS * EACH} frames, spread over a recording"
            )
        return cls(mask, np.array([known.index(key) for key in keys], np.int64), kind)


def _chosen(people: Sequence[LabelledPerson]) -> tuple[Bool, str]:
    """Return the people (n,) to hold out, and what they are."""
    whose = [", ".join(sorted(one.bodies)) for one in people]
    nameless = any(one.bodies & {"", UNKNOWN} for one in people)
    kinds: dict[str, Sequence[object]] = {} if nameless else {"people": whose}
    kinds["recordings"] = [one.recording for one in people]
    for name, keys in kinds.items():
        known = list(dict.fromkeys(keys))
        if len(known) >= EACH:
            return np.isin([known.index(key) % EACH for key in keys], [EACH // 2]), name
    return np.array([span(one) % EACH == EACH // 2 for one in people], np.bool_), "spans"


def span(person: LabelledPerson) -> int:
    """Return the number of a person's span in the recording."""
    return int(person.place * SPANS)


def split_of(held: HeldOut, synthetic: Sequence[bool], crops: Crops) -> AdaptationSplit:
    """Return the split of crops: of labelled people, then of synthetic ones.

    synthetic: True for each synthetic person that is not trained on.
    """
    every = np.concatenate([held.mask, np.array(synthetic, np.bool_)])
    labelled = np.arange(len(every)) < len(held.mask)
    places = (
        np.flatnonzero(group & (every == out)).astype(np.int64)
        for group in (labelled, ~labelled)
        for out in (False, True)
    )
    taught, left_out, rehearsed, checked = places
    return AdaptationSplit(crops, taught, left_out, held.span_of, rehearsed, checked, held.kind)

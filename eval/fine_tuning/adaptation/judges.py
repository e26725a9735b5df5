"""Judges of an adaptation: held-out people of the recordings, and synthetic people."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from eval.fine_tuning.adaptation.adaptation_gain import AdaptationGain, adaptation_gain
from eval.fine_tuning.adaptation.adaptation_split import AdaptationSplit
from eval.fine_tuning.adaptation.labelled_people import (
    LabelledPerson,
    PersonImage,
    TaughtFrames,
    image_of,
)
from eval.fine_tuning.adaptation.predicted_parts import predicted_parts, refinable
from eval.fine_tuning.adaptation.scores_on_crops import scores_on_crops
from eval.network.onnx_network import OnnxNetwork
from eval.scores.confusion import mean_recall
from eval.training.progress import Progress


@dataclass(frozen=True)
class Judges:
    """Split of the crops; label sets, and their held-out people in the order of the split."""

    split: AdaptationSplit
    sets: Sequence[TaughtFrames]
    people: Sequence[LabelledPerson]

    def images(self) -> Iterator[PersonImage]:
        """Yield the images of the held-out people."""
        return (image_of(self.sets[person.recording], person) for person in self.people)

    def gain_of(self, networks: Sequence[OnnxNetwork], progress: Progress) -> AdaptationGain:
        """Return the gain over the first of the networks by the others, which are of ``SHARES``."""
        split = self.split
        held, checked = (split.crops.chosen(index) for index in (split.held, split.checked))
        with progress("compare, images", len(networks) * (len(held) + len(checked))) as advance:
            found = [
                [scores_on_crops(one.in_scheme(held.scheme), crops, advance) for crops in (held, checked)]
                for one in networks
            ]
        if not all(refinable(network, held.scheme) for network in networks):
            return adaptation_gain(found, split)
        with progress("compare refinement, images", len(networks) * len(held)) as advance:
            matrices = predicted_parts(networks, self.images(), held.scheme, advance)
        spans = [matrices[:, :, split.span_of == n].sum(axis=2) for n in range(split.span_of.max() + 1)]
        return adaptation_gain(found, split, mean_recall(np.stack(spans, axis=2)))

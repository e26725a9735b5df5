"""Gain of an adaptation on held-out people, and its loss on synthetic ones."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from annotate.array_types import Float64
from eval.fine_tuning.adaptation.adaptation_split import AdaptationSplit
from eval.fine_tuning.adaptation.scores_on_crops import CropScores
from eval.fine_tuning.cross_validation import Gain, chosen_by_others, gain
from sensors.errors import CloudError

SHARES = (1.0, 0.5, 0.25)  # of the way from the first to the trained network, to choose from
MOST_LOST = 0.004  # of a score on synthetic people; more is forgetting; untuned


@dataclass(frozen=True)
class AdaptationGain:
    """Scores on held-out people before and after an adaptation.

    frames, spans: numbers that were held out. held_out: "people", "recordings" or "spans". parts: of the
    mean recall over spans by the network alone. joints: of the share of joints within a tenth of the trunk;
    None without joints. synthetic: recall and share of near joints on synthetic people, before and after.
    share: of the way from the first to the trained network. predicted: of the mean recall by ``predict``;
    None where refinement does not fit the labels' scheme. refined: True if ``predict`` refines the adapted
    network's labels; it refines the first network's.
    """

    frames: int
    spans: int
    held_out: str
    parts: Gain
    joints: Gain | None
    synthetic: tuple[tuple[float, float], tuple[float, float]]
    share: float
    predicted: Gain | None = None
    refined: bool = True

    @classmethod
    def of_fields(cls, fields: Mapping[str, Any]) -> Self:
        """Return the gain of JSON values.

        Raises KeyError, TypeError, ValueError and OverflowError for values of something else.
        """
        sizes = int(fields["frames"]), int(fields["spans"]), str(fields["held_out"])
        parts, joints, predicted = (
            None if fields[name] is None else Gain.of_fields(fields[name])
            for name in ("parts", "joints", "predicted")
        )
        refined = fields["refined"]
        if parts is None or not isinstance(refined, bool):
            raise ValueError("parts are missing, or refined is neither true nor false")
        (before, near), (after, near_after) = fields["synthetic"]
        known = (float(before), float(near)), (float(after), float(near_after))
        return cls(*sizes, parts, joints, known, float(fields["share"]), predicted, refined)

    @property
    def is_harmless(self) -> bool:
        """Return True if no loss is probable, and synthetic people keep their scores."""
        return all(one.high >= 0 for one in self._gains) and _kept(*np.array(self.synthetic))

    @property
    def is_certain(self) -> bool:
        """Return True if a gain is probable enough and harmless."""
        return self.is_harmless and any(one.is_certain for one in self._gains)

    @property
    def _gains(self) -> list[Gain]:
        return [one for one in (self.parts, self.predicted, self.joints) if one]

    @property
    def text(self) -> str:
        """Return the gain as text: scores before and after, intervals, probabilities."""
        how = "refined as before" if self.refined else "no longer refined"
        predicted = f"; parts by predict, {how}, {self.predicted.text}" if self.predicted else ""
        joints = f"; joints within a tenth of the trunk {self.joints.text}" if self.joints else ""
        (parts, near), (parts_after, near_after) = self.synthetic
        return (
            f"{self.frames} frames of {self.spans} spans, of other {self.held_out}: parts "
            f"{self.parts.text}{predicted}{joints}; synthetic people: parts {parts:.1%} before, "
            f"{parts_after:.1%} after, joints {near:.1%} before, {near_after:.1%} after"
        )


def adaptation_gain(
    found: Sequence[Sequence[CropScores]], split: AdaptationSplit, predicted: Float64 | None = None
) -> AdaptationGain:
    """Return the gain from scores of held-out and of synthetic people: of the start, then by ``SHARES``.

    predicted: (2, 1 + s, m), recall of each span by ``predict``, unrefined and refined; None where it cannot
    refine. Only shares that keep the scores on synthetic people are chosen from. For each span other spans
    choose share and refinement, so that several tries do not flatter the gain. If no share keeps the scores,
    the result has the share that loses least. Raises CloudError where fewer than two spans have labelled
    parts.
    """
    synthetic = [(checked.recall(), checked.near()) for _, checked in found]
    known = np.array(synthetic)
    lost = (known[0] - known[1:]).max(axis=1)
    able = [n for n in range(len(SHARES)) if _kept(known[0], known[n + 1])] or [int(lost.argmin())]
    before, after, choices = _candidates(found, split, predicted)
    usable = [n for n, (share, _) in enumerate(choices) if share in able]
    change = after[usable] - before
    both = np.nansum(change, axis=1)
    chosen = chosen_by_others(both, np.arange(both.shape[1]))
    honest = change[chosen, :, np.arange(both.shape[1])].T
    best, refined = choices[usable[int(both.mean(axis=1).argmax())]]
    parts, joints, by_predict = (
        gain(first[there], own[there], SHARES[best]) if (there := np.isfinite(own)).sum() > 1 else None
        for first, own in zip(before, honest, strict=True)
    )
    if parts is None:
        raise CloudError(
            "fewer than two held-out spans have parts whose label is sure; accept frames elsewhere in the "
            "recording"
        )
    sizes, kept = (len(split.held), both.shape[1]), (synthetic[0], synthetic[best + 1])
    return AdaptationGain(*sizes, split.held_out, parts, joints, kept, SHARES[best], by_predict, refined)


def _candidates(
    found: Sequence[Sequence[CropScores]], split: AdaptationSplit, predicted: Float64 | None
) -> tuple[Float64, Float64, list[tuple[int, bool]]]:
    """Return the scores of held-out spans before (3, m) and after (n, 3, m), and what the n are: index of the
    share, and whether ``predict`` refines.

    Scores: recall, share of near joints, and recall by ``predict``, NaN where it cannot refine.
    """
    alone = np.array([held.by_span(split.span_of) for held, _ in found])
    if predicted is None:
        predicted = np.full((2, len(alone), alone.shape[2]), np.nan)
    whole = np.array([np.append(alone, one[:, None], axis=1) for one in predicted])
    choices = [(n, refined) for refined in (True, False) for n in range(len(SHARES))]
    return whole[1, 0], np.array([whole[int(refined), n + 1] for n, refined in choices]), choices


def _kept(before: Float64, after: Float64) -> bool:
    """Return whether no score (2,) fell by more than ``MOST_LOST``."""
    return bool((before - after <= MOST_LOST).all())

"""Scores and probabilities of classes from scores of kinds and of a side: p(left arm) = p(arm) p(left)."""

import numpy as np
import torch
from torch import Tensor, nn

from annotate.scheme.merging import conversion_table
from annotate.scheme.scheme import BACKGROUND, Scheme
from eval.architecture.kinds import Kinds


def class_scores(classes: Kinds, kinds: Tensor, side: Tensor | None) -> Tensor:
    """Return class scores (B, K, H, W) from scores of kinds and of the side (B, 1, H, W).

    The logarithms are added. side: None for a scheme without sides.
    """
    if side is None:
        return kinds[:, list(classes.of_class)]
    of_side = {1: -nn.functional.softplus(-side), -1: -nn.functional.softplus(side)}
    scores = []
    for kind, which in zip(classes.of_class, classes.sides, strict=True):
        own = kinds[:, kind, None]
        scores.append(own + of_side[which] if which else own)
    return torch.cat(scores, dim=1)


def merged_scores(scores: Tensor, own: Scheme, scheme: Scheme) -> Tensor:
    """Return scores (B, k, ...) of the classes of ``scheme`` from (B, K, ...) of ``own``.

    The probability of a class is the sum of its parts'. Raises FormatError where a class would be split.
    """
    if own == scheme:
        return scores
    ids = conversion_table(own, scheme)[own.class_ids]
    merged = [scores[:, np.flatnonzero(ids == part)].logsumexp(dim=1) for part in scheme.class_ids]
    return torch.stack(merged, dim=1)


def softmax(scores: Tensor) -> Tensor:
    """Return the softmax of scores (B, n, H, W) over n; ONNX Runtime's own takes five times as long there."""
    odds = torch.exp(scores - scores.amax(dim=1, keepdim=True))
    return odds / odds.sum(dim=1, keepdim=True)


def kind_odds(kinds: Tensor) -> Tensor:
    """Return the exponential of scores (B, n, ...), of each pixel relative to its highest score."""
    return torch.exp(kinds - kinds.amax(dim=1, keepdim=True))


def class_probabilities(classes: Kinds, kinds: Tensor, side: Tensor | None, seen: Tensor) -> Tensor:
    """Return the softmax (B, K, H, W) of class scores, background where not seen.

    kinds, side: as in ``class_scores``. seen: (B, 1, H, W). Kinds are fewer than classes, so this takes less
    time than a softmax of the classes.
    """
    odds = kind_odds(kinds)
    # A product of matrices takes a fifth of the time of ONNX Runtime's sum along this axis.
    total = (odds.new_ones(1, len(classes)) @ odds.flatten(2)).reshape(seen.shape)
    share = seen.to(odds.dtype) / total
    shares = [share]
    if side is not None:
        left = share * torch.sigmoid(side)
        shares += [left, share - left]
    each = torch.split(odds, 1, dim=1)
    planes = [each[kind] * shares[which] for kind, which in zip(classes.of_class, classes.sides, strict=True)]
    planes[BACKGROUND] = planes[BACKGROUND] + (1 - seen.to(odds.dtype))
    return torch.cat(planes, dim=1)

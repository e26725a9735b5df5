"""Interface of 2-D pose networks, and the people that one finds in an image."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from annotate.array_types import Float32, Float64, UInt8
from annotate.witness.person_crop import PersonCrop

LEAST = 0.5  # least score of a person in a crop (MediaPipe's graph)
SAME = 0.5  # least shared part of the smaller of two boxes about one person's landmarks; untuned
WIDENED = (1.5, 2.0)  # further sides of a detection's crop: finds people with hidden faces; untuned
SURER = 0.9  # least score in such a crop: fewer false alarms; by 20 frames with and 10 without a person


@dataclass(frozen=True, eq=False)
class PosedPerson:
    """Person in a colour image.

    landmarks: float64 (n, 3), column, row in pixels (pixel centres at halves) and visibility in [0, 1], by
    the network's ``names``. crop: for the next frame. mask: float32 (h, w) in [0, 1], whether a pixel of the
    image shows the person; None if the network gives none.
    """

    landmarks: Float64
    crop: PersonCrop
    mask: Float32 | None = None


class PoseNetwork(Protocol):
    """Top-down 2-D pose network: finds the landmarks of one person in a crop.

    names: of the landmarks; joints are named as in ``annotate.joint_names``.
    """

    @property
    def names(self) -> Sequence[str]: ...
    @property
    def sha256(self) -> str: ...
    def detect(self, image: UInt8) -> list[PersonCrop]:
        """Return crops about people in an image (h, w, 3), the surest first; [] without a detector."""
        ...

    def landmark(self, image: UInt8, crop: PersonCrop, least: float = LEAST) -> PosedPerson | None:
        """Return the person in a crop; None for a score below ``least``."""
        ...


def people_in(image: UInt8, network: PoseNetwork, crops: Iterable[PersonCrop]) -> list[PosedPerson]:
    """Return the people of an image (h, w, 3), first in the proposed crops, then detected ones.

    A person whose landmarks overlap an earlier person's is left out.
    """
    found: list[PosedPerson] = []
    detected = network.detect(image)
    wider = [(one._replace(side=k * one.side), SURER) for one in detected for k in WIDENED]
    for crop, least in (*((crop, LEAST) for crop in (*crops, *detected)), *wider):
        person = network.landmark(image, crop, least)
        if person and not any(shared(person.landmarks, one.landmarks) > SAME for one in found):
            found.append(person)
    return found


def shared(a: Float64, b: Float64) -> float:
    """Return the part of the smaller box about two persons' landmarks (n, 3) that both boxes share."""
    boxes = [np.concatenate([one[:, :2].min(axis=0), one[:, :2].max(axis=0)]) for one in (a, b)]
    both, own, other = intersection(boxes[0], boxes[1][None])
    return float(both[0] / max(min(own, other[0]), 1e-9))


def intersection(box: Float64, others: Float64) -> tuple[Float64, float, Float64]:
    """Return the shared area (n,) of a box (4,) with others (n, 4), and both areas.

    A box: left, top, right, bottom.
    """
    low, high = np.maximum(box[:2], others[:, :2]), np.minimum(box[2:], others[:, 2:])
    both = np.prod(np.maximum(high - low, 0), axis=-1)
    own = float(np.prod(np.maximum(box[2:] - box[:2], 0)))
    return both, own, np.prod(np.maximum(others[:, 2:] - others[:, :2], 0), axis=1)

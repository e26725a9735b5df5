"""Labels by a suit and by a colour network together."""

from dataclasses import dataclass, replace

import numpy as np

from annotate.array_types import Bool, Float32, UInt8
from annotate.frame_labels import FrameLabels
from annotate.label_recording import SuitDetection, SuitLabeller
from annotate.person.extract import PersonMask
from annotate.scheme.scheme import Scheme
from annotate.segmentation.segmented_person import Segmentation
from annotate.witness.coloured_cloud import ColouredCloud, ColourFuser
from eval.network.colour.colour_labeller import ColourDetection, ColourLabeller
from sensors.rig.rig_calibration import RigCalibration


@dataclass(frozen=True, eq=False)
class SuitAndColourLabeller:
    """Labeller whose outline and subject are the suit's, and whose parts come from both.

    Frames that the suit leaves undefined are labelled by colour, and the other way round. Both have one
    scheme.
    """

    suit: SuitLabeller
    colour: ColourLabeller

    @property
    def scheme(self) -> Scheme:
        """Return the scheme of the labels."""
        return self.colour.scheme

    def fuser(self, calibration: RigCalibration) -> ColourFuser:
        """Return the fusion of depth and colour."""
        return self.colour.fuser(calibration)

    def detect(self, cloud: ColouredCloud) -> tuple[SuitDetection, ColourDetection]:
        """Return both detections of a frame."""
        return self.suit.detect(cloud.cloud), self.colour.detect(cloud)

    def label(
        self, detection: tuple[SuitDetection, ColourDetection], before: FrameLabels | None
    ) -> tuple[Segmentation, PersonMask]:
        """Return the labels and the persons of a frame. before: labels of the previous frame."""
        (by_suit, person), (by_colour, persons) = (
            self.suit.label(detection[0], before),
            self.colour.label(detection[1], before),
        )
        if not by_suit.confidence.any():
            return by_colour, persons
        if not by_colour.confidence.any():
            return by_suit, person
        both = (by_suit.confidence > 0) & (by_colour.confidence > 0)
        parts, sure = by_suit.parts.copy(), by_suit.confidence.copy()
        first, second = ((one.parts[both], one.confidence[both]) for one in (by_suit, by_colour))
        parts[both], sure[both] = product(first, second, len(self.scheme.body_classes))
        return replace(by_suit, parts=parts, confidence=sure, bearing=by_colour.bearing), person


def product(
    first: tuple[UInt8, Float32], second: tuple[UInt8, Float32], classes: int
) -> tuple[UInt8, Float32]:
    """Return the likelier of two labels (n,) with confidence, and its probability under both.

    Each label stands for a distribution over ``classes``: its confidence, and the rest spread evenly.
    """
    (a, p), (b, q) = ((one, sure.clip(1e-3, 1 - 1e-3)) for one, sure in (first, second))
    p_rest, q_rest = (1 - p) / (classes - 1), (1 - q) / (classes - 1)
    same: Bool = a == b
    of_a = p * np.where(same, q, q_rest)
    of_b = np.where(same, of_a, q * p_rest)
    others = np.where(same, classes - 1, classes - 2) * p_rest * q_rest
    best = np.maximum(of_a, of_b)
    total = np.where(same, of_a, of_a + of_b) + others
    return np.where(of_a >= of_b, a, b), (best / total).astype(np.float32)

"""Images held out from a training, to fit the softmax temperature that calibrates the confidences.

Constants are untuned.
"""

from dataclasses import dataclass

import numpy as np
from natsort import natsorted

from eval.training.crops import Crops

SHARE = 0.05  # of the bodies, or else of the images, that is left out
LEAST_BODIES = 10  # from which whole bodies are left out
LEAST_IMAGES = 100  # from which single images are left out
NAMED = 5  # bodies that a note names


@dataclass(frozen=True)
class CalibrationSplit:
    """Crops to train on and crops to calibrate on, which share no image.

    calibrated: None where there are too few images. bodies: held out with every image that shares one; empty
    where single images of the trained people were held out.
    """

    trained: Crops
    calibrated: Crops | None
    bodies: tuple[str, ...]

    def described(self) -> dict[str, object]:
        """Return the split as JSON values."""
        images = 0 if self.calibrated is None else len(self.calibrated)
        return {"images": images, "subjects": list(self.bodies)}

    @property
    def note(self) -> str:
        """Return a sentence on the data to which the confidences were calibrated."""
        if self.calibrated is None:
            return f"{len(self.trained)} images are too few to calibrate on: confidences are as trained"
        if self.bodies:
            named = ", ".join(self.bodies[:NAMED]) + (", ..." if len(self.bodies) > NAMED else "")
            people = f"{len(self.bodies)} people who are not trained on: {named}"
            return f"calibrated on {len(self.calibrated)} images of {people}"
        return f"calibrated on {len(self.calibrated)} images left out, of the people that are trained on"


def calibration_split(crops: Crops) -> CalibrationSplit:
    """Return crops with a twentieth held out: of the bodies, or of the images where bodies are few."""
    names = natsorted(set().union(*crops.bodies))
    chosen: tuple[str, ...] = ()
    left_out = np.ones(len(crops), np.bool_)
    if len(names) >= LEAST_BODIES:
        chosen = tuple(names[i] for i in _spread(len(names)))
        left_out = crops.showing(chosen)
    if left_out.all() and len(crops) >= LEAST_IMAGES:
        chosen, left_out = (), np.zeros(len(crops), np.bool_)
        left_out[_spread(len(crops))] = True
    if left_out.all():
        return CalibrationSplit(crops, None, ())
    rest, held = (crops.chosen(np.flatnonzero(mask).astype(np.int64)) for mask in (~left_out, left_out))
    return CalibrationSplit(rest, held, chosen)


def _spread(count: int) -> list[int]:
    """Return evenly spread indices of the share ``SHARE`` of ``count`` items."""
    n = max(1, round(count * SHARE))
    return [int((i + 0.5) * count / n) for i in range(n)]

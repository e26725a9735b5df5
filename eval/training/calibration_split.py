"""Images that a training leaves out, to fit the temperature of its confidences on.

Constants are untuned.
"""

from dataclasses import dataclass

import numpy as np
from natsort import natsorted

from eval.training.crops import Crops

SHARE = 0.05  # of the subjects, or else of the images, that is left out
LEAST_SUBJECTS = 10  # from which whole subjects are left out
LEAST_IMAGES = 100  # from which single images are left out
NAMED = 5  # subjects that a note names


@dataclass(frozen=True)
class CalibrationSplit:
    """Crops to train on and crops to calibrate on, which share no image.

    calibrated: None where there are too few images. subjects: left out whole; empty where single images of
    the trained people were left out.
    """

    trained: Crops
    calibrated: Crops | None
    subjects: tuple[str, ...]

    def described(self) -> dict[str, object]:
        """Return the split as JSON values."""
        images = 0 if self.calibrated is None else len(self.calibrated)
        return {"images": images, "subjects": list(self.subjects)}

    @property
    def note(self) -> str:
        """Return a sentence on the data to which the confidences were calibrated."""
        if self.calibrated is None:
            return f"{len(self.trained)} images are too few to calibrate on: confidences are as trained"
        if self.subjects:
            named = ", ".join(self.subjects[:NAMED]) + (", ..." if len(self.subjects) > NAMED else "")
            people = f"{len(self.subjects)} subjects that are not trained on: {named}"
            return f"calibrated on {len(self.calibrated)} images of {people}"
        return f"calibrated on {len(self.calibrated)} images left out, of the people that are trained on"


def calibration_split(crops: Crops) -> CalibrationSplit:
    """Leave out a twentieth of the subjects, or of the images where there are few subjects."""
    names = natsorted(set(crops.subjects.tolist()))
    chosen: tuple[str, ...] = ()
    if len(names) >= LEAST_SUBJECTS:
        chosen = tuple(names[i] for i in _spread(len(names)))
        left_out = np.isin(crops.subjects, chosen)
    elif len(crops) >= LEAST_IMAGES:
        left_out = np.zeros(len(crops), np.bool_)
        left_out[_spread(len(crops))] = True
    else:
        return CalibrationSplit(crops, None, ())
    rest, held = (crops.chosen(np.flatnonzero(mask).astype(np.int64)) for mask in (~left_out, left_out))
    return CalibrationSplit(rest, held, chosen)


def _spread(count: int) -> list[int]:
    """Return evenly spread indices of the left-out share of ``count`` items."""
    n = max(1, round(count * SHARE))
    return [int((i + 0.5) * count / n) for i in range(n)]

"""Second stage of person detection: a network rates the surroundings of a candidate, at one metric size.

In the finder's input a person's size depends on the distance. The verifier's crop of fixed size in metres
shows the whole candidate and the room around it. Constants are untuned.
"""

from functools import cache
from importlib.resources import files

import cv2
import numpy as np

from annotate.array_types import Bool, Float32
from annotate.onnx_session import Network, onnx_session

SIDE, SIDE_M = 80, 2.4  # of a crop: pixels, metres
DEPTH_M = 1.2  # difference from the candidate's depth that the channel shows as 1
RELIEF, RELIEF_SIDE = 8.0, 9  # factor (1/m) of depth less its local mean; side of the mean's window in pixels
ODDS = 4.0  # log odds of a pixel that the channel shows as 1
INPUTS = 6  # channels of `crop_input`


def person_odds(crops: Float32) -> Float32:
    """Return the log odds (n,) that candidates are persons, by crops (n, 6, SIDE, SIDE) of `crop_input`."""
    found: Float32 = _network().run(None, {"crop": crops})[0][:, 0]
    return found


@cache
def _network() -> Network:
    return onnx_session(files("annotate").joinpath("person/detection/verifier.onnx").read_bytes())


def crop_input(depth_m: Float32, odds: Float32, mask: Bool, focal_px: tuple[float, float]) -> Float32:
    """Return the input (6, SIDE, SIDE) for a candidate.

    depth_m: (h, w), metres, 0 = no reading. odds: (h, w), log odds of being a person. mask: (h, w), pixels of
    the candidate, at least one, all with readings. focal_px: of columns and rows. Channels: inside the image,
    has a reading, depth less the candidate's median, depth less its local mean, log odds, mask.
    """
    v, u = np.nonzero(mask)
    middle_m = float(np.median(depth_m[v, u]))
    steps = ((np.arange(SIDE) + 0.5) / SIDE - 0.5) * SIDE_M / max(middle_m, 0.1)
    columns, rows = (
        np.rint(at.mean() + focal * steps).astype(int) for at, focal in zip((u, v), focal_px, strict=True)
    )
    height, width = depth_m.shape
    inside = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))
    at = np.ix_(rows.clip(0, height - 1), columns.clip(0, width - 1))
    z, shown = depth_m[at], inside & (depth_m[at] > 0)
    valid = shown.astype(np.float32)
    window = (RELIEF_SIDE, RELIEF_SIDE)
    total, count = (cv2.blur(np.asarray(image, np.float32), window) for image in (z * valid, valid))
    relief = np.clip((z - total / np.maximum(count, 1e-3)) * RELIEF, -1, 1)
    away = np.clip((z - middle_m) / DEPTH_M, -1, 1)
    sure = np.clip(odds[at] / ODDS, -2, 2)
    channels = (inside, valid, away * valid, relief * valid, sure * valid, mask[at] & shown)
    return np.stack(channels).astype(np.float32)

"""Network of the person finder: each pixel's log odds of being a person, and votes for its person's middle.

Its input is depth and, if recorded, warmth, at a focal length of 274 pixels. Training:
`annotate/person/detection/finder.md`.
"""

from functools import cache
from importlib.resources import files

import cv2
import numpy as np

from annotate.array_types import Float32
from annotate.onnx_graph import without_channels
from annotate.onnx_session import Network, onnx_session

FOCAL_PX = 274.0  # of the network's images; at 183 it found 0.82, not 0.90, of people in crowds (development)
MULTIPLE = 64  # sides are padded to multiples, because the network halves an image six times
LOCAL_GAINS = {61: 8.0, 15: 40.0}  # factors of log depth less its local mean, by side of the mean's window
MOST_LOCAL = 4.0  # bound of these channels
DEPTH_INPUTS = 4 * (2 + len(LOCAL_GAINS))  # images of the input that depth gives, the first ones
WARMTH = (-1.0, 2.0)  # range of the channel: from a cold pane to a radiator


def network_input(depth_m: Float32, warmth: Float32) -> Float32:
    """Return the input (24, h / 2, w / 2) for depth (h, w) in metres, 0 = no reading, and warmth (h, w); h, w
    even.

    Six channels, each split into four images of every second pixel (space to depth). The channels are: depth
    is valid, log depth, log depth minus its mean in a wide and in a narrow window, warmth is valid, warmth.
    """
    valid = (depth_m > 0).astype(np.float32)
    log = np.where(depth_m > 0, np.log(np.maximum(depth_m, 0.1)), 0).astype(np.float32)
    channels = [valid, log]
    for side, gain in LOCAL_GAINS.items():
        total, count = (
            cv2.blur(image, (side, side), borderType=cv2.BORDER_CONSTANT) for image in (log, valid)
        )
        local = np.clip((log - total / np.maximum(count, 1e-3)) * gain, -MOST_LOCAL, MOST_LOCAL)
        channels.append((local * valid).astype(np.float32))
    felt = np.isfinite(warmth) & (depth_m > 0)
    channels += [felt.astype(np.float32), np.where(felt, np.clip(warmth, *WARMTH), 0).astype(np.float32)]
    return np.stack([image[v::2, u::2] for image in channels for v in (0, 1) for u in (0, 1)])


@cache
def _network(*, is_felt: bool) -> Network:
    """Return the network; without temperatures, with fewer inputs and the same result."""
    file = files("annotate").joinpath("person/detection/finder.onnx").read_bytes()
    return onnx_session(file if is_felt else without_channels(file, "image", range(DEPTH_INPUTS)))


def odds_and_votes(points_m: Float32, warmth: Float32) -> tuple[Float32, Float32]:
    """Return the log odds (h, w) that points (h, w, 3) are on a person, and votes (h', w', 3) of every second
    point.

    A vote is the estimated centre of the point's person, metres. Without warmth the result is the mean of the
    image's and of the mirror image's.
    """
    height, width = points_m.shape[:2]
    more = ((0, -height % MULTIPLE), (0, -width % MULTIPLE))
    given = network_input(np.pad(points_m[..., 2], more), np.pad(warmth, more))
    voters, is_felt = points_m[::2, ::2], bool(np.isfinite(warmth).any())
    given = given if is_felt else given[:DEPTH_INPUTS]
    # A flip swaps the columns' parity channels and negates the votes to the right.
    images = [given] if is_felt else [given, given[np.arange(len(given)) ^ 1, :, ::-1]]
    network = _network(is_felt=is_felt)
    outputs = [network.run(None, {"image": image[None]})[0][0] for image in images]
    for turned in outputs[1:]:
        turned[:] = turned[[1, 0, 3, 2, 4, 5, 6], :, ::-1]
        turned[4] *= -1
    found: Float32 = sum(outputs) / len(outputs)
    odds = found[:4].reshape(2, 2, *found.shape[1:]).transpose(2, 0, 3, 1).reshape(2 * given.shape[1], -1)
    right, down, away = found[4:, : voters.shape[0], : voters.shape[1]]
    # A vote lies beside the point at its depth, moved along the ray.
    z = np.maximum(voters[..., 2], 0.1)
    ray = (z + away) / z
    x, y = voters[..., 0] + right, voters[..., 1] + down
    return odds[:height, :width], np.stack([x * ray, y * ray, z + away], axis=-1)

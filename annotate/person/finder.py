"""Person detection in a cloud: a small network gives each pixel log odds and a vote for its person's centre.

Its input is depth and, if recorded, warmth, resampled to one focal length. Pixels with nearby votes form one
person, so people who touch stay apart. Training: `annotate/person/finder.md`. Constants are untuned unless a
source is given.
"""

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import NamedTuple

import cv2
import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, UInt8
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.onnx_graph import without_channels
from annotate.onnx_session import Network, onnx_session
from annotate.person.odds import KEPT_ODDS, Evidence
from annotate.person.votes import Voters, persons_by_votes

FOCAL_PX = 183.0  # of the images that the network is trained on, half of a Kinect v2's
MULTIPLE = 64  # sides are padded to multiples, because the network halves an image six times
LOCAL_GAINS = {61: 8.0, 15: 40.0}  # factors of log depth less its local mean, by side of the mean's window
MOST_LOCAL = 4.0  # bound of these channels
DEPTH_INPUTS = 4 * (2 + len(LOCAL_GAINS))  # images of the input that depth gives, the first ones
WARMTH = (-1.0, 2.0)  # range of the channel: from a cold pane to a radiator
CUT_OUT_ODDS = 4.0  # added where the background is cut away; finds 0.997 of these persons instead of 0.99
BESIDE_SURFACE = 0.03  # share of the depth at which a neighbour's weight falls to 1/e
MOST_PERSON_M2 = 2.5  # visible surface: twice the front of a tall adult
# Greatest shares of the border and of the image with depth, where the background is cut away. Of 200 tight
# crops of development people 99 % have less, of 89 empty close rooms 13 %.
MOST_BORDER, MOST_KNOWN = 0.5, 0.75


@dataclass(frozen=True)
class Person:
    """Detected person: mask (h, w), area of the visible surface, mean point (3,) in the depth
    camera's frame, and evidence for being a person.
    """

    mask: Bool
    area_m2: float
    centre_m: Float64
    evidence: Evidence

    @property
    def odds(self) -> float:
        """Return the log odds of being a person."""
        return self.evidence.odds


def find_people(
    cloud: ThermalCloud, warmth: Float32, *, single_pass: bool = False, least_odds: float = KEPT_ODDS
) -> list[Person]:
    """Detect all people of a cloud, in no order.

    warmth: (h, w), 0 at the room's temperature, 1 at a person's; NaN = no reading. single_pass: skip the
    flipped image, which halves the time. least_odds: of a person.
    """
    v, u = map(_grid, cloud.depth_mm.shape, (cloud.camera.fy, cloud.camera.fx))
    rows, columns = (np.rint(grid).astype(np.intp) for grid in (v, u))
    small_m, felt = (plane.take(rows, axis=0).take(columns, axis=1) for plane in (cloud.points_m, warmth))
    small_m = np.nan_to_num(small_m, copy=False)
    odds, votes_m = _found(small_m, felt, single_pass)
    z = np.ascontiguousarray(small_m[..., 2])
    surface_m2 = z**2 * np.float32(_spacing(v) * _spacing(u) / (cloud.camera.fx * cloud.camera.fy))
    if surface_m2.sum() <= MOST_PERSON_M2 and _is_cut_out(z):
        odds += CUT_OUT_ODDS
    likely = (odds > 0) & (z > 0)
    voting = likely[::2, ::2]
    whose = np.zeros(odds.shape, np.uint8)
    voters = Voters(votes_m, small_m[::2, ::2], 4 * surface_m2[::2, ::2], odds[::2, ::2])
    whose[::2, ::2][voting], evidence = persons_by_votes(voters.chosen(voting), least_odds)
    # Every second pixel votes; pixels between take their neighbours' person.
    between = cv2.dilate(whose, np.ones((3, 3), np.uint8))
    whose = np.where(whose > 0, whose, np.where(likely, between, 0)).astype(np.uint8)
    odds[likely & (whose == 0)] = -1
    owner = _enlarged(cloud.points_m, _Small(z, odds, whose, v, u))
    people = ((owner == number, known) for number, known in enumerate(evidence, start=1))
    return [_person(cloud, mask, known) for mask, known in people if mask.any()]


def _person(cloud: ThermalCloud, mask: Bool, evidence: Evidence) -> Person:
    points = cloud.points_m[mask].astype(np.float64)
    area_m2 = float(np.sum(points[:, 2] ** 2)) / (cloud.camera.fx * cloud.camera.fy)
    return Person(mask, area_m2, points.mean(axis=0), evidence)


def _is_cut_out(depth_m: Float32) -> bool:
    """Return whether the background of depth (h, w) is missing; the walls of a close room are background."""
    known = depth_m > 0
    border = np.concatenate([known[0], known[-1], known[:, 0], known[:, -1]])
    return bool(border.mean() <= MOST_BORDER and known.mean() <= MOST_KNOWN)


def _grid(side: int, focal_px: float) -> Float64:
    """Return the coordinates (n,) along an image's side that resample its focal length to ``FOCAL_PX``."""
    step = max(focal_px / FOCAL_PX, 1.0)
    count = max(1, round(side / step))
    return np.asarray(((np.arange(count) + 0.5) * step - 0.5).clip(0, side - 1), np.float64)


def _spacing(grid: Float64) -> float:
    return float(grid[1] - grid[0]) if len(grid) > 1 else 1.0


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
    file = files("annotate").joinpath("person/finder.onnx").read_bytes()
    return onnx_session(file if is_felt else without_channels(file, "image", range(DEPTH_INPUTS)))


def _found(points_m: Float32, warmth: Float32, single_pass: bool = False) -> tuple[Float32, Float32]:
    """Return the log odds (h, w) that points (h, w, 3) are on a person, and votes (h', w', 3) of every second
    point.

    A vote is the estimated centre of the point's person, metres. single_pass: skip the flipped image.
    """
    height, width = points_m.shape[:2]
    more = ((0, -height % MULTIPLE), (0, -width % MULTIPLE))
    given = network_input(np.pad(points_m[..., 2], more), np.pad(warmth, more))
    voters, is_felt = points_m[::2, ::2], bool(np.isfinite(warmth).any())
    given = given if is_felt else given[:DEPTH_INPUTS]
    # A flip swaps the columns' parity channels and negates the votes to the right.
    images = [given] if single_pass else [given, given[np.arange(len(given)) ^ 1, :, ::-1]]
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
    return odds[:height, :width].copy(), np.stack([x * ray, y * ray, z + away], axis=-1)


class _Small(NamedTuple):
    """Resampled image: metres, log odds and person number (h', w') at pixels (rows, columns) of the whole
    image.
    """

    depth_m: Float32
    odds: Float32
    whose: UInt8
    rows: Float64
    columns: Float64


@njit(cache=True, nogil=True)
def _enlarged(points_m: Float32, small: _Small) -> UInt8:
    """Return the person number (h, w) of points (h, w, 3), from the neighbours in the resampled image, mainly
    those on the same surface.
    """
    small_m, odds, whose, rows, columns = small
    height, width = points_m.shape[:2]
    owner = np.zeros((height, width), np.uint8)
    row_step = (rows[-1] - rows[0]) / max(len(rows) - 1, 1) or 1.0
    column_step = (columns[-1] - columns[0]) / max(len(columns) - 1, 1) or 1.0
    for v in range(height):
        y = (v - rows[0]) / row_step
        above = int(np.floor(y))
        for u in range(width):
            x = (u - columns[0]) / column_step
            before, empty = int(np.floor(x)), True
            for k in range(4):
                r = min(max(above + k // 2, 0), len(rows) - 1)
                c = min(max(before + k % 2, 0), len(columns) - 1)
                empty &= whose[r, c] == 0
            z = points_m[v, u, 2]
            if empty or not z > 0:
                continue
            total, most = 0.0, 0.0
            for k in range(4):
                r, c = above + k // 2, before + k % 2
                share = (1.001 - abs(y - r)) * (1.001 - abs(x - c))
                r, c = min(max(r, 0), len(rows) - 1), min(max(c, 0), len(columns) - 1)
                if small_m[r, c] > 0:
                    weight = share * np.exp(-abs(small_m[r, c] - z) / (BESIDE_SURFACE * z))
                    total += weight * odds[r, c]
                    if whose[r, c] > 0 and weight > most:
                        most, owner[v, u] = weight, whose[r, c]
            if total <= 0:
                owner[v, u] = 0
    return owner

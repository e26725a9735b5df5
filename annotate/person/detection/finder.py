"""Person detection in a cloud: a network gives each pixel log odds and a vote for its person's middle.

Pixels with nearby votes form one candidate, so people who touch stay apart. Without temperatures a second
network rates each candidate, unless the background is cut away. Constants are untuned unless a source is
given.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from annotate.array_types import Bool, Float32, Float64, UInt8
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.person.detection.candidates import Candidates, rated
from annotate.person.detection.finder_network import FOCAL_PX, odds_and_votes
from annotate.person.detection.odds import KEPT_ODDS, Evidence
from annotate.person.detection.votes import Voters

# Added to pixels and to one person where the background is cut away; 14 of 550 people are lost, with 2 28.
CUT_OUT_ODDS = 4.0
BESIDE_SURFACE = 0.03  # share of the depth at which a neighbour's weight falls to 1/e
LEAST_STEP = 0.5  # pixels of the image by one of the network's; less takes longer with wide views
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


def find_people(cloud: ThermalCloud, warmth: Float32, least_odds: float = KEPT_ODDS) -> list[Person]:
    """Detect all people of a cloud, in no order.

    warmth: (h, w), 0 at the room's temperature, 1 at a person's; NaN = no reading. least_odds: least
    log odds of a returned person.
    """
    v, u = map(_grid, cloud.depth_mm.shape, (cloud.camera.fy, cloud.camera.fx))
    rows, columns = (
        np.rint(grid).clip(0, side - 1).astype(np.intp)
        for grid, side in zip((v, u), cloud.depth_mm.shape, strict=True)
    )
    small_m, felt = (plane.take(rows, axis=0).take(columns, axis=1) for plane in (cloud.points_m, warmth))
    small_m = np.nan_to_num(small_m, copy=False)
    focal_px = (cloud.camera.fx / _spacing(u), cloud.camera.fy / _spacing(v))
    candidates = candidates_in(small_m, felt, focal_px)
    is_felt = (np.isfinite(felt) & (candidates.depth_m > 0)).any()
    if not is_felt and not _is_cut_out(candidates.depth_m, focal_px):
        candidates = rated(candidates)
    kept, evidence = candidates.best(least_odds)
    whose, odds = candidates.owners(kept), candidates.odds
    odds = np.where(candidates.likely & (whose == 0), np.float32(-1), odds)
    owner = _enlarged(cloud.points_m, _Small(candidates.depth_m, odds, whose, v, u))
    people = ((owner == number, known) for number, known in enumerate(evidence, start=1))
    return [_person(cloud, mask, known) for mask, known in people if mask.any()]


def candidates_in(points_m: Float32, warmth: Float32, focal_px: tuple[float, float]) -> Candidates:
    """Return the candidates for persons in an image.

    points_m: (h, w, 3), z = 0 without a reading. focal_px: of columns and rows, about ``FOCAL_PX``. Others as
    in `find_people`.
    """
    odds, votes_m = odds_and_votes(points_m, warmth)
    depth_m = np.ascontiguousarray(points_m[..., 2])
    surface_m2 = depth_m**2 * np.float32(1 / (focal_px[0] * focal_px[1]))
    if is_cut_out := _is_cut_out(depth_m, focal_px):
        odds += CUT_OUT_ODDS
    likely = (odds > 0) & (depth_m > 0)
    voters = Voters(votes_m, points_m[::2, ::2], 4 * surface_m2[::2, ::2], odds[::2, ::2])
    candidates = Candidates.of(depth_m, odds, focal_px, voters.chosen(likely[::2, ::2]))
    return candidates.with_one_surer(CUT_OUT_ODDS) if is_cut_out else candidates


def _person(cloud: ThermalCloud, mask: Bool, evidence: Evidence) -> Person:
    points = cloud.points_m[mask].astype(np.float64)
    area_m2 = float(np.sum(points[:, 2] ** 2)) / (cloud.camera.fx * cloud.camera.fy)
    return Person(mask, area_m2, points.mean(axis=0), evidence)


def _is_cut_out(depth_m: Float32, focal_px: tuple[float, float]) -> bool:
    """Return whether depth (h, w) shows little and lacks the background; a close room's walls are background.

    focal_px: of columns and rows.
    """
    known = depth_m > 0
    if np.square(depth_m).sum() > MOST_PERSON_M2 * focal_px[0] * focal_px[1]:
        return False
    border = np.concatenate([known[0], known[-1], known[:, 0], known[:, -1]])
    return bool(border.mean() <= MOST_BORDER and known.mean() <= MOST_KNOWN)


def _grid(side: int, focal_px: float) -> Float64:
    """Return the coordinates (n,), evenly spaced along an image's side, that resample its focal length to
    ``FOCAL_PX``. The outermost lie up to half a pixel beyond the middles of the outermost pixels.
    """
    step = max(focal_px / FOCAL_PX, LEAST_STEP)
    count = max(1, round(side / step))
    return np.asarray(((np.arange(count) + 0.5) * step - 0.5).clip(-0.5, side - 0.5), np.float64)


def _spacing(grid: Float64) -> float:
    return float(grid[1] - grid[0]) if len(grid) > 1 else 1.0


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

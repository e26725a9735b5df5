"""Sides of bare hands and shoes, whose colours are the same on both sides: the sides of sleeves and legs.

UNSIDED is the best of 0.25, 0.5, 1 on 176 virtual frames of all scenes; the other constants are untuned.
"""

import numpy as np
from numba import njit

from annotate.array_types import Float32, Int32, Int64, UInt8
from annotate.cloud.grid import JUMP, components
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.scheme.regions import Region
from annotate.scheme.scheme import Scheme
from annotate.segmentation.input_channels import Rectangle
from annotate.suit.color_model import BARE, ColorModel, readable

UNSIDED = 0.25  # difference of a colour's log likelihoods on both sides, below which the colour has no side
CLEAR = 1.5  # the same, from which it has
MOST_AGAINST = 0.2  # contact with the other side's cloth, share of the contact with the own
LEAST_CONTACT = 8  # pairs of pixels at most two rows and columns apart


def settle_sides(
    cloud: ThermalCloud, where: Rectangle, chance: Float32, illuminant: ColorModel, scheme: Scheme
) -> Float32:
    """Return probabilities (K + 1, h, w) of a rectangle; a bare piece gets the side of its sleeve or leg.

    A bare piece is a connected surface of one limb's end whose colours have no side. Clear cloth of that end
    has the same side by colour and by the network. If the piece touches clear cloth on one side only, or
    nearly so, the probabilities of the other side move to that side.
    """
    named = chance.argmax(axis=0)
    depth_m = np.nan_to_num(cloud.points_m[where][..., 2])
    lean = _lean(cloud, where, named, illuminant, scheme)
    settled = chance.copy()
    for left, right in _ends(scheme):
        on_left, on_right = (np.isin(named, side) & cloud.valid[where] for side in (left, right))
        clear = [on_left & (lean >= CLEAR), on_right & (lean <= -CLEAR)]
        cloth = np.select(clear, [1, 2], 0).astype(np.uint8)
        pieces, count = components((on_left | on_right) & (np.abs(lean) < UNSIDED), depth_m)
        touched = _contacts(pieces, count, cloth, depth_m)
        for to, source, own, other in ((left, right, 1, 2), (right, left, 2, 1)):
            sure = touched[:, own] >= LEAST_CONTACT
            sure &= touched[:, other] <= MOST_AGAINST * touched[:, own]
            here = sure[pieces]
            for one, twin in zip(to, source, strict=True):
                settled[one, here] += settled[twin, here]
                settled[twin, here] = 0
    return settled


def _ends(scheme: Scheme) -> list[tuple[list[int], list[int]]]:
    """Return the classes of each limb's end that may be bare: those on the left, their twins on the right."""
    ends = []
    for _, _, names in BARE:
        ids = scheme.ids_of(Region.on("left", name.lower()) for name in names)
        left = [int(scheme.class_table[i]) for i in ids if scheme.twin_table[i] != i]
        ends.append((left, scheme.twin_classes[left].tolist()))
    return ends


def _lean(
    cloud: ThermalCloud, where: Rectangle, named: Int64, illuminant: ColorModel, scheme: Scheme
) -> Float32:
    """Return the log likelihood (h, w) of each colour on the left of its class, less that on the right."""
    lean = np.zeros(named.shape, np.float32)
    row = np.zeros(len(scheme.class_ids) + 1, np.int64)
    row[scheme.body_classes] = np.arange(len(scheme.body_classes))
    for left, right in _ends(scheme):
        here = np.isin(named, [*left, *right])
        rgb = cloud.color_rgb[where][here]
        usable = readable(rgb, cloud.color_valid[where][here])
        evidence, own = illuminant.evidence(rgb[usable], scheme), named[here][usable]
        values = np.zeros(len(own), np.float32)
        for one, twin in zip(left, right, strict=True):
            mine = (own == one) | (own == twin)
            values[mine] = evidence[row[one], mine] - evidence[row[twin], mine]
        found = np.zeros(len(rgb), np.float32)
        found[usable] = values
        lean[here] = found
    return lean


@njit(cache=True, nogil=True)
def _contacts(pieces: Int32, count: int, cloth: UInt8, depth_m: Float32) -> Int64:
    """Return the contacts (count + 1, 3) of pieces with each value of ``cloth``, 1 and 2."""
    height, width = pieces.shape
    touched = np.zeros((count + 1, 3), np.int64)
    for v in range(height):
        for u in range(width):
            if pieces[v, u] == 0:
                continue
            jump_m = np.float32(JUMP) * depth_m[v, u]
            for r in range(max(v - 2, 0), min(v + 3, height)):
                for c in range(max(u - 2, 0), min(u + 3, width)):
                    if cloth[r, c] > 0 and abs(depth_m[r, c] - depth_m[v, u]) <= jump_m:
                        touched[pieces[v, u], cloth[r, c]] += 1
    return touched

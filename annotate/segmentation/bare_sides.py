"""Sides of bare hands and shoes, whose colours do not differ between the sides: those of sleeves and legs.

Constants are untuned unless a source is given.
"""

import numpy as np
from numba import njit

from annotate.array_types import Float32, Int32, Int64
from annotate.cloud.grid import JUMP, components
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.scheme.regions import Region
from annotate.scheme.scheme import Scheme
from annotate.segmentation.input_channels import Rectangle
from annotate.suit.color_model import BARE, ColorModel, readable

CLEAR = 1.5  # difference of log likelihoods from which a colour is clearly of one side
MOST_AGAINST = 0.2  # contact with the other side's cloth, share of the contact with the own
LEAST_CONTACT_PX = 6  # pairs of neighbouring pixels


def settle_sides(
    cloud: ThermalCloud, where: Rectangle, chance: Float32, illuminant: ColorModel, scheme: Scheme
) -> Float32:
    """Return probabilities (K + 1, h, w) of a rectangle; a bare piece gets the side of its sleeve or leg.

    A bare piece is a connected surface of one limb's end whose colours are not clearly of one side. If the
    piece touches clear cloth of that end on one side only, or nearly so, the probabilities of the
    other side move to that side.
    """
    named = chance.argmax(axis=0)
    depth_m = np.nan_to_num(cloud.points_m[where][..., 2])
    lean = _lean(cloud, where, named, illuminant, scheme)
    settled = chance.copy()
    for left, right in _ends(scheme):
        at_end = np.isin(named, [*left, *right]) & cloud.valid[where]
        pieces, count = components(at_end & (np.abs(lean) < CLEAR), depth_m)
        touched = _contacts(pieces, count, np.where(at_end, lean, np.float32(0)), depth_m)
        for wanted, other, own, against in ((left, right, 0, 1), (right, left, 1, 0)):
            sure = touched[:, own] >= LEAST_CONTACT_PX
            sure &= touched[:, against] <= MOST_AGAINST * touched[:, own]
            sure[0] = False
            here = sure[pieces]
            for to, source in zip(wanted, other, strict=True):
                settled[to, here] += settled[source, here]
                settled[source, here] = 0
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
def _contacts(pieces: Int32, count: int, lean: Float32, depth_m: Float32) -> Int64:
    """Return the contacts (count + 1, 2) of pieces with clear cloth on the left and on the right."""
    height, width = pieces.shape
    touched = np.zeros((count + 1, 2), np.int64)
    for v in range(height):
        for u in range(width):
            piece = pieces[v, u]
            if piece == 0:
                continue
            jump_m = np.float32(JUMP) * depth_m[v, u]
            for r in range(max(v - 2, 0), min(v + 3, height)):
                for c in range(max(u - 2, 0), min(u + 3, width)):
                    if abs(lean[r, c]) >= CLEAR and abs(depth_m[r, c] - depth_m[v, u]) <= jump_m:
                        touched[piece, 0 if lean[r, c] > 0 else 1] += 1
    return touched

"""Labels that have been read from a suit, looked at again with all that is known of a person by then.

The first look goes by what is true of every suit and body. What it leaves is rather alike from person to
person: a hand on a thigh has no colour of its own, a blanket that covers the legs looks like cloth. A small
network that has seen many such frames of the virtual rig tells these, and what else is the person's.
"""

from dataclasses import replace

import numpy as np

from annotate.array_types import Bool, Float64
from annotate.cloud.supervoxels import Supervoxels
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.engine import Engine
from annotate.frame_labels import FrameLabels
from annotate.parts import BODY_PARTS
from annotate.person.clothed_mask import Clues, filled
from annotate.person.extract import PersonMask
from annotate.second_look.descriptors import described, neighbours
from annotate.second_look.network import Network
from annotate.segmentation.reading import Reading
from annotate.segmentation.segment import Segmentation, labelled
from annotate.suit.color_model import readable
from sensors.rig.nearest import Nearest

LEAST, MOST_ODDS = 1e-4, 6.0
"""No class is less likely than the first; the most that the network tells of a pixel being the person's."""


def look_again(
    cloud: ThermalCloud,
    person: PersonMask,
    first: Segmentation,
    before: FrameLabels | None,
    engine: Engine | None = None,
) -> tuple[Segmentation, PersonMask]:
    """Better labels, and a better mask; the same where the suit could not be read or nothing is felt.

    before: the labels of the frame before.
    """
    engine, reading, seen = engine or Engine(), first.reading, person.undecided
    if reading is None or seen is None:
        return first, person
    clues, groups = seen.clues, seen.clues.groups
    pairs = neighbours(groups.centroids_m(cloud.points_m[clues.own]))
    rows = described(cloud, person.mask, seen, first, before)
    chance = Network(**engine.weights.network)(rows, pairs, clues.patches.ids, groups.sizes)
    theirs = np.log(1 - chance[:, 0] + LEAST) - np.log(chance[:, 0] + LEAST)
    theirs = np.clip(theirs, -MOST_ODDS, MOST_ODDS)
    mask = seen.decided(filled(theirs[groups.ids], clues.own)) & ~person.others
    if not mask.any():
        return first, person
    belief = chance[:, 1:] / np.maximum(chance[:, 1:].sum(axis=1, keepdims=True), 1e-12)
    labels = labelled(cloud, _reread(cloud, mask, clues, belief, theirs, reading), engine, first.notes)
    return labels, replace(person, mask=mask)


def _reread(
    cloud: ThermalCloud, mask: Bool, clues: Clues, belief: Float64, theirs: Float64, first: Reading
) -> Reading:
    """The points of a mask (h, w), read anew.

    belief (G, 11), theirs (G,): log odds of being the person's, about supervoxels of every second pixel.
    """
    nearest = Nearest(cloud.points_m[clues.own]).query(cloud.points_m[mask])[1]
    used, ids = np.unique(clues.groups.ids[nearest], return_inverse=True)
    renumbered = np.full(clues.groups.count, -1, np.int32)
    renumbered[used] = np.arange(len(used))
    edges = renumbered[clues.groups.edges]
    groups = Supervoxels(ids.astype(np.int32), len(used), edges[(edges >= 0).all(axis=1)])
    rgb = cloud.color_rgb[mask]
    usable = readable(rgb, cloud.color_valid[mask])
    evidence = np.zeros((len(rgb), len(BODY_PARTS)))
    evidence[usable] = first.model.evidence(rgb[usable])
    return Reading(first.suit, mask, groups, belief[used], theirs[used], usable, evidence, first.model)

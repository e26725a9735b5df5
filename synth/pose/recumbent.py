"""Lying in bed or fallen: supine, prone, on a side, curled up, half off the bed, on the floor."""

import numpy as np

from annotate.array_types import Float64
from synth.body.body import Body, pose
from synth.body.flesh import flesh_of
from synth.body.skeleton import JOINT_ID, Posture
from synth.pose.attitude import posture_of, pulls_of
from synth.pose.contact import height_to_rest, lift_needed
from synth.pose.moment import Behaviour, Moment, Posed, pose_families
from synth.pose.settle import settle
from synth.surface.furniture import FLOOR, Bed, Ground

HEAD_FROM_EDGE_M = 0.20
"""The head joint lies this far from the bed's upper end where ``along`` is 0: in the middle of the pillow."""
HEAVE = 0.03
"""Readiness of the body to rise off an arm under it, rad^2/m^2 beside a limb's 1. Chosen by eye."""

_FAMILIES = pose_families("recumbent")
IN_BED, FALLEN = _FAMILIES["in_bed"], _FAMILIES["fallen"]


def in_bed(bed: Bed) -> Behaviour:
    """Lying in a bed."""
    return Behaviour(IN_BED, tuple(IN_BED.activities), lambda body, moment: lie(body, bed, moment))


def lie(body: Body, support: Bed | Ground, moment: Moment) -> Posed:
    """A lying body: vertices float32 (V, 3) and joints (J, 3) of a moment, world, metres.

    The trunk rests on the support, sunk in by its give; limbs and head sink until something carries them.
    """
    flesh, posture = flesh_of(body), posture_of(moment)
    carriers = [FLOOR, *support.solids()[:1]]
    vertices, joints = pose(body, posture)
    place = _place(support, moment, joints)
    place[2] = height_to_rest(vertices[flesh.trunk] + place.astype(np.float32), carriers)
    solids = [FLOOR, *support.solids()]
    settled = settle(flesh, Posture(posture.angles_rad, place), solids, pulls_of(moment), HEAVE)
    vertices, joints = pose(body, settled)
    up = lift_needed(vertices, carriers)
    return vertices + np.array([0, 0, up], np.float32), joints + np.array([0, 0, up])


def _place(support: Bed | Ground, moment: Moment, joints: Float64) -> Float64:
    """Place (3,) of the pelvis, its height left open: the head lies near the support's upper end."""
    half = support.length / 2 - HEAD_FROM_EDGE_M
    spine = joints[JOINT_ID["head"]] - joints[JOINT_ID["pelvis"]]
    along = half - float(np.hypot(spine[0], spine[1])) - moment["along"]
    return np.array([moment["off"] * (support.width / 2), along, 0.0])

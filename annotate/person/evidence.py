"""Log odds (h, w) of a person before planes, colours and neighbours count: by warmth or the frame before.

Without temperatures (the flag is closed) unchanged depth keeps its label; surface nearer than before is
likely a person's, farther surface the room's.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from annotate.array_types import Bool, Float32, UInt8
from annotate.cloud.grid import grown
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.parts import BACKGROUND
from annotate.person.alignment import degrees, thermal_alignment
from annotate.person.pixel_odds import (
    WINDOW_C,
    cold_surface_odds,
    find_window,
    temperature_odds,
    warmth_share,
)
from annotate.person.planes import MIN_COLD_PLANE_M2, MIN_PANEL_M2, Plane, close_to, find_planes, panel_of

LOCAL_M, COLD_REACH_M = 0.3, 0.3
"""Metres in which temperatures are compared, to each side, and in which a cold one holds for pixels without
one, along a surface. Chosen by eye."""
SURROUNDINGS_M = 0.4
"""Metres from warm surface that a cold sleeve or a foot behind an arm rest may reach. Chosen by eye."""
LEGS_M, FAINT_FOOT = 0.9, 0.25
"""Metres from warm surface of a foot seen below a blanket, and its least share of warmth. Chosen by eye."""
SURELY_COLD, EDGES_PX = 0.12, 25
"""Share of a person's warmth below which a surface close to a plane is no candidate; pixels around warm
surface whose silhouettes are compared, four degrees. Chosen by eye."""
UNCHANGED_DEPTH = 0.012
"""Depth difference of pure noise as a share of the depth: four standard deviations of a Kinect v2's, measured
at 2 m (Fankhauser et al. 2015)."""
STILL_SHARE = 0.6
"""Least share of the background with unchanged depth; below it the rig has moved. Chosen by eye."""
UNCHANGED_ODDS, CHANGED_ODDS = 3.0, 1.5
"""Log odds of a label at unchanged depth, and of a person nearer or the room farther. Chosen by eye."""


@dataclass(frozen=True)
class Evidence:
    """Log odds (h, w) of being a person, planes, colours and neighbours not yet counted.

    candidates: bool (h, w), pixels to decide on; the others are background. cold: bool (h, w), background if
    close to a plane. nobody: the note where no person is found. notes: remarks on the frame. warnings:
    reasons not to trust it. window_c, share: by temperature, a person's degrees Celsius, and the share
    float32 (h, w) of the way there from the background's, NaN = not felt.
    """

    method: Literal["thermal", "before"]
    odds: Float32
    candidates: Bool
    cold: Bool
    planes: tuple[Plane, ...]
    nobody: str
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    window_c: tuple[float, float] = WINDOW_C
    share: Float32 | None = None


def thermal_evidence(
    cloud: ThermalCloud,
    window_c: tuple[float, float] | None,
    planes: tuple[Plane, ...],
    *,
    suited: bool,
) -> Evidence:
    """Evidence by temperature; arguments as of ``Survey``, planes: those of the whole cloud."""
    loose = cloud.valid & ~close_to(planes, cloud.points_m)
    low, high = window_c or find_window(cloud, loose) or WINDOW_C
    celsius = cloud.temperature_c
    planes += find_planes(cloud, loose & (celsius < low), MIN_COLD_PLANE_M2)
    loose &= ~close_to(planes, cloud.points_m)
    hot = loose & (celsius >= low)
    panel = np.zeros_like(hot)
    # A chest can be as flat as a screen; with a suit, colours part the two.
    for plane in find_planes(cloud, hot, MIN_PANEL_M2) if not suited else ():
        panel |= panel_of(plane, cloud, hot)
    loose &= ~panel
    warm = loose & (celsius >= low) & (celsius <= high)
    nobody = (
        f"no person in the thermal and depth images: nothing of human size is {low:.1f} to {high:.1f} "
        "degrees warm; let somebody step into the view, or give the window of temperatures"
    )
    if not warm.any():
        return Evidence("thermal", np.zeros(loose.shape, np.float32), warm, warm, planes, nobody)
    alignment = thermal_alignment(cloud, (low, high), grown(warm, EDGES_PX))
    pixels_per_m = cloud.camera.fx / float(np.median(cloud.points_m[..., 2][warm]))
    share = warmth_share(celsius, warm, (low, high), 2 * round(LOCAL_M * pixels_per_m) + 1)
    cold = share < SURELY_COLD
    near_warm = grown(warm, SURROUNDINGS_M * pixels_per_m)
    legs = loose & (share > FAINT_FOOT) & grown(warm, LEGS_M * pixels_per_m)
    candidates = cloud.valid & (near_warm & (loose | ~cold) | legs) & ~panel
    right, down = alignment.shift_px
    warning = (
        f"thermal image lies {right:+.0f}, {down:+.0f} pixels (right, down) off the depth image, "
        f"{degrees(alignment.shift_px, cloud.camera):.1f} degrees: calibrate the thermal camera again; "
        "parts are undefined"
    )
    odds = temperature_odds(share, celsius, high)
    odds += cold_surface_odds(odds, cloud, candidates, COLD_REACH_M * pixels_per_m)
    warnings = (warning,) * alignment.is_off
    return Evidence("thermal", odds, candidates, cold, planes, nobody, (), warnings, (low, high), share)


def previous_evidence(
    cloud: ThermalCloud, before: FrameLabels | None, planes: tuple[Plane, ...]
) -> Evidence | None:
    """Evidence by the previous frame's labels; None if that has nobody or another size, or the rig moved."""
    if before is None or before.depth_mm.shape != cloud.depth_mm.shape:
        return None
    person, both = persons_before(before) > 0, cloud.valid & (before.depth_mm > 0)
    behind = cloud.depth_mm.astype(np.float32) - before.depth_mm
    slack = UNCHANGED_DEPTH * np.maximum(cloud.depth_mm, before.depth_mm).astype(np.float32)
    same, rest = both & (np.abs(behind) <= slack), both & ~person
    if not person.any() or not rest.any() or same[rest].mean() < STILL_SHARE:
        return None
    odds = np.where(same, np.where(person, UNCHANGED_ODDS, -UNCHANGED_ODDS), 0.0).astype(np.float32)
    odds[both & (behind < -slack)] = CHANGED_ODDS
    odds[both & (behind > slack)] = -CHANGED_ODDS
    still, loose = same & ~person, ~close_to(planes, cloud.points_m)
    there = person & (before.depth_mm > 0)
    pixels_per_m = cloud.camera.fx * 1000 / float(np.median(before.depth_mm[there]))
    candidates = cloud.valid & grown(there, SURROUNDINGS_M * pixels_per_m) & (loose | ~still)
    nobody = (
        "no person: no thermal image in this frame, and the person of the frame before is gone; "
        "label again from a frame with both"
    )
    note = "no temperature in this frame: the person is carried over from the frame before"
    return Evidence("before", odds, candidates, still, planes, nobody, (note,))


def persons_before(before: FrameLabels) -> UInt8:
    """Persons uint8 (h, w) of a frame's labels: 0 nobody, 1 the labelled person, 2 and on others."""
    return np.asarray(before.parts != BACKGROUND, np.uint8) if before.persons is None else before.persons

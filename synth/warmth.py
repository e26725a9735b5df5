"""The thermal camera's view: a warm person in a room that is not evenly cold."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.parts import PART_ID
from synth.body import Body
from synth.render import Mesh, ZBuffer
from synth.scene import Surface
from synth.view import hair_faces

SUPERSAMPLE = 3
"""Renders per FIR pixel side: its silhouette pixels mix person and background, as real ones do."""

PART_C = {
    "head": 33.5,
    "torso": 30.5,
    "left_upper_arm": 30.0,
    "right_upper_arm": 30.0,
    "left_forearm": 30.5,
    "right_forearm": 30.5,
    "hip": 30.0,
    "left_upper_leg": 29.5,
    "right_upper_leg": 29.5,
    "left_lower_leg": 28.8,
    "right_lower_leg": 28.8,
}
"""Clothed and bare surface temperatures of a person at rest in a 21 C room (tight thin clothing sits
between skin, 32-34 C, and air; ISO 7933 annex on clothing surface temperature)."""
HAIR_C = 27.5
SURFACE_C = {
    Surface.FLOOR: 20.0,
    Surface.WALL: 20.5,
    Surface.SOFA: 21.5,
    Surface.TABLE: 21.0,
    Surface.RADIATOR: 45.0,
    Surface.MUG: 52.0,
}


@dataclass(frozen=True)
class ThermalNoise:
    """The FIR camera's faults: noise-equivalent temperature difference, lens blur, drift of all pixels."""

    netd_c: float = 0.08
    blur_px: float = 0.6
    drift_c: float = 0.0


def body_temperatures(body: Body, rng: np.random.Generator, spread_c: float) -> NDArray[np.float64]:
    """Temperature (F,) of every body face: by part, hair apart, in patches ``spread_c`` apart."""
    by_part = np.zeros(12)
    for name, celsius in PART_C.items():
        by_part[PART_ID[name]] = celsius
    temperature = by_part[body.face_parts]
    temperature[hair_faces(body)] = HAIR_C
    centre = body.vertices_m[body.faces].mean(axis=1)
    waves = rng.normal(0, 9.0, (3, 6))
    patches = np.sin(centre @ waves + rng.uniform(0, 2 * np.pi, 6)).sum(axis=1) / np.sqrt(3)
    return np.asarray(temperature + spread_c * patches)


def surface_temperatures(mesh: Mesh, rng: np.random.Generator, spread_c: float) -> NDArray[np.float64]:
    """Temperature (F,) of furniture by its tag, each kind a little off."""
    table = np.zeros(max(Surface) + 1)
    for surface, celsius in SURFACE_C.items():
        table[surface] = celsius + spread_c * rng.normal()
    return np.asarray(table[mesh.tags])


def thermograph(
    seen: ZBuffer,
    celsius: NDArray[np.float64],
    ambient_c: float,
    noise: ThermalNoise,
    maps: tuple[NDArray[np.float32], NDArray[np.float32]],
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """A supersampled pinhole render and face temperatures (F,) -> float32 (h, w) degrees Celsius.

    maps: where each distorted supersampled pixel looks in the render (cv2.remap's x and y).
    """
    table = np.append(celsius, ambient_c).astype(np.float32)
    fine = cv2.remap(table[seen.face], *maps, interpolation=cv2.INTER_NEAREST)
    height, width = fine.shape[0] // SUPERSAMPLE, fine.shape[1] // SUPERSAMPLE
    image = cv2.resize(fine, (width, height), interpolation=cv2.INTER_AREA)
    if noise.blur_px > 0:
        image = cv2.GaussianBlur(image, (0, 0), noise.blur_px)
    grain = rng.standard_normal(image.shape, dtype=np.float32) * np.float32(noise.netd_c)
    return np.asarray(image + grain + np.float32(noise.drift_c), np.float32)

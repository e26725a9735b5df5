"""Photographs of a scene by the colour camera: dressed people among furniture, as a JPEG.

Cast: a set of synthetic people and things (``synth.data_files``).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float32, Float64, Int32, UInt8
from annotate.suit.palette import Suit
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose
from synth.appearance.color_camera import (
    CameraFaults,
    CameraState,
    adjusted,
    develop,
    encode,
    first_state,
    flow_px,
    metered,
    smear,
)
from synth.appearance.lighting import EVEN_LIGHT, Lighting, LightSpread, illuminate, light_room
from synth.appearance.outfit import GAMMA, Outfit, Wear
from synth.appearance.paint import RoomColors, paint
from synth.data_files import JUDGE, TRAINING, Cast, table, table_of
from synth.surface.facets import wavelength_cells
from synth.surface.furniture import SURFACES, Surface
from synth.surface.rasterize import Mesh, face_means, rasterize


@dataclass(frozen=True)
class ColorDifficulty:
    """Difficulty of colour images. light: None is even white light. equal: probability that an object has a
    colour of the suit.
    """

    wear: Wear
    light: LightSpread | None
    camera: CameraFaults
    equal: float


def _color(entry: dict[str, Any]) -> ColorDifficulty:
    light = LightSpread(**entry["light"]) if "light" in entry else None
    return ColorDifficulty(Wear(**entry["wear"]), light, CameraFaults(**entry["camera"]), entry["equal"])


COLORS = {name: _color(entry["color"]) for name, entry in table("difficulties").items()}
CLEAN, NORMAL, HARD = COLORS.values()
_PLAIN = (0.0, 1.0, 1.0)  # without grain
COLORFUL = (Surface.SOFA, Surface.MUG, Surface.BED, Surface.BLANKET, Surface.PILLOW)
LATER = (Surface.WOOD, Surface.PAD, Surface.PET)  # surfaces of training rooms with warm things


def plain_room(cast: Cast = TRAINING) -> RoomColors:
    """Return one plain colour, without grain, for each thing in a cast's rooms."""
    chosen = {Surface[name.upper()]: np.array(entry["rgb"]) for name, entry in _own_colors(cast).items()}
    return _room(chosen, with_grain=False)


def _own_colors(cast: Cast) -> dict[str, dict[str, Any]]:
    return table_of(cast, "surfaces") if cast == JUDGE else {}


def paint_room(suit_rgb: UInt8, equal: float, rng: np.random.Generator, cast: Cast = TRAINING) -> RoomColors:
    """Draw common colours and patterns of the things in a cast's rooms.

    equal: probability that a thing has one of the suit's colours (K, 3) instead.
    """
    own = table_of(cast, "surfaces")
    bed = own["bed"].get("often", [[200, 200, 206]])
    chosen = {
        Surface.SOFA: rng.choice(own["sofa"]["often"]),
        Surface.FLOOR: rng.choice(own["floor"]["often"]),
        Surface.WALL: rng.choice(own["wall"]["often"]),
        Surface.BED: (np.array(bed[0]) if len(bed) == 1 else rng.choice(bed)) + rng.normal(0, 14, 3),
        Surface.MUG: rng.uniform(30, 230, 3),
        Surface.BLANKET: rng.choice(own["blanket"]["often"]),
    }
    for surface in COLORFUL:
        same, swatch = rng.random() < equal, rng.choice(suit_rgb)
        if same:
            chosen[surface] = swatch
    later = rng.spawn(1)[0]  # because further numbers of rng would change every recording of a seed
    chosen |= {surface: later.choice(SURFACES[surface]["often"]) for surface in LATER}
    return _room(chosen, with_grain=True)


def _room(chosen: dict[Surface, NDArray[np.generic]], with_grain: bool) -> RoomColors:
    rgb, grain = np.zeros((2, max(Surface) + 1, 3))
    for surface, entry in SURFACES.items():
        rgb[surface] = np.maximum(chosen.get(surface, entry["rgb"]), 0)
        share, across, along = entry.get("grain", _PLAIN)
        grain[surface] = (share * with_grain, wavelength_cells(across), wavelength_cells(along))
    return RoomColors(np.power(rgb / 255, GAMMA), grain)


@dataclass(frozen=True)
class Setting:
    """Colours and lamps of a room in one episode; offset_s: time from depth image to colour image."""

    room: RoomColors
    lighting: Lighting
    offset_s: float


def set_up(color: ColorDifficulty, suit: Suit, rng: np.random.Generator, cast: Cast = TRAINING) -> Setting:
    """Draw the colours of a cast's room, its lights and the colour camera's time offset.

    Uses the same random numbers at every difficulty.
    """
    room = paint_room(suit.colors_rgb, color.equal, rng, cast)
    offset_s = color.camera.offset_s * rng.uniform(-1, 1)
    if color.light is None:
        return Setting(plain_room(cast), EVEN_LIGHT, offset_s)
    return Setting(room, light_room(color.light, rng), offset_s)


class ColorCamera:
    """Colour camera whose exposure and white balance adapt to the scenes.

    pinhole: wide camera that is rendered; maps: ``cv2.remap`` coordinates from its image to the lens's.
    state: exposure and white balance at the latest photograph.
    """

    def __init__(
        self,
        pinhole: Intrinsics,
        maps: tuple[Float32, Float32],
        color_from_world: Pose,
        setting: Setting,
        faults: CameraFaults,
    ) -> None:
        self.pinhole, self.maps, self.color_from_world = pinhole, maps, color_from_world
        self.setting, self.faults = setting, faults
        self.state: CameraState | None = None
        self._metered = np.zeros(3)

    def photograph(
        self,
        scene: Mesh,
        outfits: Sequence[Outfit],
        rng: np.random.Generator,
        velocity_m_s: Float64 | None = None,
    ) -> bytes:
        """Return the JPEG of a scene (world frame), ``setting.offset_s`` after the depth image.

        The scene begins with the faces and vertices of the outfits and moves at velocity_m_s (V, 3).
        """
        if velocity_m_s is not None:
            later = scene.vertices_m + self.setting.offset_s * velocity_m_s
            scene = Mesh(later.astype(np.float32), scene.faces, scene.tags)
        points = self.color_from_world.apply(scene.vertices_m)
        seen = rasterize(self.pinhole, points.astype(np.float32), scene.faces)
        surfaces = paint(seen, (self.pinhole, self.color_from_world), scene, outfits, self.setting.room)
        light = illuminate(surfaces, scene, self.setting.lighting)
        if self.state is None:
            state = first_state(metered(light), self.faults, rng)
        else:
            state = adjusted(self.state, self._metered, self.faults, rng)
        self.state, self._metered = state, metered(light)
        if velocity_m_s is not None and self.faults.shutter > 0:
            seconds = self.faults.shutter * state.exposure_s
            light = smear(light, seen.face, self._flow(points, scene.faces, velocity_m_s, seconds))
        image = np.asarray(cv2.remap(light, *self.maps, interpolation=cv2.INTER_LINEAR), np.float32)
        return encode(develop(image, state, self.faults, rng))

    def _flow(self, points_m: Float64, faces: Int32, velocity_m_s: Float64, seconds: float) -> Float32:
        """Return the image motion (F + 1, 2), pixels, of every face during an exposure; the last row is 0."""
        turned = velocity_m_s @ self.color_from_world.rotation.T
        by_vertex = flow_px(self.pinhole, points_m, turned, seconds)
        return np.concatenate([face_means(by_vertex, faces), np.zeros((1, 2), np.float32)])

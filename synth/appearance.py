"""The colour camera's view: suit, skin and furniture under room light, as a JPEG."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from annotate.suit import Suit
from sensors.errors import FormatError
from synth.body import Body
from synth.render import Mesh, ZBuffer
from synth.scene import Surface
from synth.skeleton import JOINT_ID
from synth.view import hair_faces

JPEG_QUALITY = 90

SURFACE_RGB = {
    Surface.FLOOR: (122, 104, 86),
    Surface.WALL: (206, 202, 190),
    Surface.SOFA: (92, 90, 96),
    Surface.TABLE: (140, 108, 78),
    Surface.RADIATOR: (228, 228, 224),
    Surface.MUG: (168, 58, 44),
}


@dataclass(frozen=True)
class Light:
    """Room light. toward: unit vectors (L, 3) to each lamp, world; rgb: (L, 3) strengths; ambient: (3,)."""

    toward: NDArray[np.float64]
    rgb: NDArray[np.float64]
    ambient: NDArray[np.float64]

    @staticmethod
    def sample(rng: np.random.Generator, spread: float) -> "Light":
        """A window and a lamp; ``spread`` 0..1 widens how far colour and direction stray."""
        toward = np.array([[0.5, -0.5, 0.8], [-0.4, -0.9, 0.5]]) + spread * rng.normal(0, 0.4, (2, 3))
        toward /= np.linalg.norm(toward, axis=1, keepdims=True)
        tint = 1 + spread * rng.normal(0, 0.06, (2, 3))
        return Light(toward, np.array([[0.5], [0.3]]) * tint, 0.35 * (1 + spread * rng.normal(0, 0.04, 3)))


@dataclass(frozen=True)
class ColorNoise:
    """The colour camera's faults: sensor noise (of 255), blur in pixels, exposure factor."""

    sigma: float = 3.0
    blur_px: float = 0.6
    exposure: float = 1.0


def body_colors(
    body: Body, suit: Suit, skin_rgb: NDArray[np.float64], hair_rgb: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Linear colour (F, 3) of every body face: the suit, a bare face in its hood, hair at the brow."""
    colors = np.stack([suit.colors_rgb[suit.parts == p][0] for p in range(1, 12)])[body.face_parts - 1]
    centre = body.vertices_m[body.faces].mean(axis=1)
    head = body.joints_m[JOINT_ID["head"]]
    is_head = body.face_parts == 1
    front = is_head & (centre[:, 1] < head[1] - 0.02) & (np.abs(centre[:, 0]) < 0.065)
    colors = colors.astype(np.float64)
    colors[front] = skin_rgb
    colors[hair_faces(body) & front] = hair_rgb
    return np.asarray(np.power(colors / 255, 2.2))


def surface_colors(mesh: Mesh) -> NDArray[np.float64]:
    """Linear colour (F, 3) of furniture by its tag."""
    table = np.zeros((max(Surface) + 1, 3))
    for surface, rgb in SURFACE_RGB.items():
        table[surface] = rgb
    return np.asarray(np.power(table[mesh.tags] / 255, 2.2))


def shade(mesh: Mesh, colors: NDArray[np.float64], light: Light) -> NDArray[np.float64]:
    """Lambertian light on every face: linear colours (F, 3) -> (F, 3). Both sides are lit alike."""
    a, b, c = (mesh.vertices_m[mesh.faces[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
    direct = np.maximum(normal @ light.toward.T, 0) @ light.rgb
    return colors * (light.ambient + direct)


def photograph(
    seen: ZBuffer,
    lit: NDArray[np.float64],
    noise: ColorNoise,
    maps: tuple[NDArray[np.float32], NDArray[np.float32]],
    rng: np.random.Generator,
) -> bytes:
    """A pinhole render and its lit faces (F, 3) -> the camera's JPEG: lens, blur, noise and gamma.

    maps: where each distorted pixel looks in the pinhole render (cv2.remap's x and y).
    """
    table = np.concatenate([lit, np.zeros((1, 3))]) * noise.exposure
    srgb = (255 * np.power(np.clip(table, 0, 1), 1 / 2.2)).astype(np.uint8)
    image = cv2.remap(srgb[seen.face], *maps, interpolation=cv2.INTER_LINEAR)
    if noise.blur_px > 0:
        image = cv2.GaussianBlur(image, (0, 0), noise.blur_px)
    if noise.sigma > 0:
        grain = rng.standard_normal((image.shape[0] // 2, image.shape[1] // 2, 3), dtype=np.float32)
        # Demosaicing correlates noise over two pixels.
        wide = cv2.resize(grain * np.float32(noise.sigma), image.shape[1::-1])
        image = np.asarray(np.clip(image + wide, 0, 255), np.uint8)
    ok, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not ok:
        raise FormatError(f"colour image {image.shape} cannot be encoded as JPEG")
    return bytes(data)

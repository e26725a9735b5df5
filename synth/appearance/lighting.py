"""Illuminants of a room: lamps with soft shadows, and light reflected by the walls.

Shadows are shadow maps (Williams 1978) of several points of each lamp; the walls are one more lamp.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np

from annotate.array_types import Float32, Float64
from sensors.rig.camera import Intrinsics
from synth.appearance.paint import Surfaces
from synth.surface.furniture import Surface
from synth.surface.rasterize import EXACT, Mesh, look_at, rasterize

STRIDE = 4  # pixels between shadows, which are interpolated on the same surface
PLACES = 4  # shadow maps a lamp
MAP_PX = 256  # side of a shadow map
_MAP_CAMERA = Intrinsics(MAP_PX, MAP_PX, 120.0, 120.0, (MAP_PX - 1) / 2, (MAP_PX - 1) / 2)  # 94 degrees
_LIFT_M, _BIAS_M = 0.012, 0.012  # start of a shadow off its surface, and behind its caster
_TINY = np.float32(1e-9)
_ALIKE_M = 0.04  # distance of pixels that share a shadow
CHEST_M = np.array([0.0, 0.0, 0.7])  # reference point of a lamp's strength, world
BOUNCE_M = np.array(
    [(-1.6, -1.2, 2.4), (1.6, -1.2, 2.4), (0.0, -2.8, 1.9), (-2.3, -0.6, 1.0), (2.3, -0.6, 1.0)]
)  # sources of the light reflected by ceiling and walls
BOUNCE_FLOOR = 0.3  # share of the reflected light in the deepest corner


@dataclass(frozen=True)
class LightSpread:
    """Ranges of a room's light; untuned.

    level: median light on the chest, and its logarithmic standard deviation. lamps: number of lamps.
    returned: share of light that walls reflect. kelvin: coldest and warmest lamp.
    """

    level: tuple[float, float]
    lamps: tuple[int, int]
    returned: tuple[float, float]
    kelvin: tuple[float, float]


@dataclass(frozen=True)
class Lighting:
    """Lamps of a room.

    place_m: (L, PLACES, 3) sample points of each lamp, world; rgb: (L, 3) irradiance on a chest facing the
    lamp. ambient: (3,) light reflected by the walls; sky: share of ambient light from above.
    """

    place_m: Float64
    rgb: Float64
    ambient: Float64
    sky: float


EVEN_LIGHT = Lighting(np.zeros((0, PLACES, 3)), np.zeros((0, 3)), np.ones(3), 0.0)
# Window, ceiling lamp, standing lamp: place, its spread, half the size (metres), and warmth, 0 to 1.
_KINDS = (
    ((2.35, -1.4, 1.45), (0.05, 0.6, 0.15), (0.05, 0.6, 0.6), 0.0),
    ((0.2, -1.0, 2.35), (0.6, 0.6, 0.05), (0.2, 0.2, 0.02), 0.6),
    ((1.5, 0.1, 1.55), (0.25, 0.5, 0.15), (0.1, 0.1, 0.12), 1.0),
)


def light_room(spread: LightSpread, rng: np.random.Generator) -> Lighting:
    """Draw up to three lamps of a room: a window, a ceiling lamp and a standing lamp."""
    count = rng.integers(spread.lamps[0], spread.lamps[1] + 1)
    on = sorted(rng.choice(len(_KINDS), count, replace=False))
    level = spread.level[0] * np.exp(spread.level[1] * rng.normal())
    returned = rng.uniform(*spread.returned)
    share = rng.dirichlet(np.full(count, 3.0)) * (1 - returned) * 1.6
    side = rng.choice((-1.0, 1.0))
    places, colors = [], []
    for kind, part in zip(on, share, strict=True):
        centre, stray, half, warmth = (np.array(value) for value in _KINDS[kind])
        mirror = np.array([side if kind != 2 else -side, 1, 1])
        middle = mirror * (centre + stray * rng.uniform(-1, 1, 3))
        places.append(middle + half * _stratified(rng))
        cold, warm = spread.kelvin
        kelvin = cold + (warm - cold) * np.clip(warmth + rng.normal(0, 0.15), 0, 1)
        colors.append(level * part * white_rgb(float(kelvin)))
    mean = np.mean(colors, axis=0)
    ambient = level * returned * (0.5 + 0.5 * mean / mean.mean())
    return Lighting(np.array(places), np.array(colors), ambient, 0.35)


def _stratified(rng: np.random.Generator) -> Float64:
    quarter = np.array([(0, -1, -1), (0, -1, 1), (0, 1, -1), (0, 1, 1)])
    return np.asarray((quarter + rng.uniform(-1, 1, (4, 3))) / 2)


def white_rgb(kelvin: float) -> Float64:
    """Return the linear sRGB (3,), mean 1, of a black body of ``kelvin`` (Kim et al. 2002, US patent
    7024034).
    """
    t = 1000.0 / np.clip(kelvin, 1667.0, 25000.0)
    if kelvin < 4000:
        x = -0.2661239 * t**3 - 0.2343589 * t**2 + 0.8776956 * t + 0.179910
    else:
        x = -3.0258469 * t**3 + 2.1070379 * t**2 + 0.2226347 * t + 0.240390
    if kelvin < 2222:
        y = -1.1063814 * x**3 - 1.34811020 * x**2 + 2.18555832 * x - 0.20219683
    elif kelvin < 4000:
        y = -0.9549476 * x**3 - 1.37418593 * x**2 + 2.09137015 * x - 0.16748867
    else:
        y = 3.0817580 * x**3 - 5.87338670 * x**2 + 3.75112997 * x - 0.37001483
    xyz = np.array([x / y, 1.0, (1 - x - y) / y])
    # IEC 61966-2-1, XYZ to linear sRGB.
    matrix = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
    rgb = np.maximum(matrix @ xyz, 0.02)
    return np.asarray(rgb / rgb.mean())


def illuminate(surfaces: Surfaces, scene: Mesh, lighting: Lighting) -> Float32:
    """Return the linear light (h, w, 3) that each pixel's surface reflects, with shadows of the scene."""
    places = [*lighting.place_m.reshape(-1, 3)]
    if lighting.sky == 0 and not places:
        return np.asarray(surfaces.albedo * lighting.ambient.astype(np.float32), np.float32)
    lit = _lit(surfaces, scene, np.array([*places, *BOUNCE_M]))
    lamps = len(lighting.rgb)
    shadow = np.empty((*lit.shape[:2], lamps + 1), np.float32)
    for lamp in range(lamps):
        shadow[..., lamp] = lit[..., lamp * PLACES : (lamp + 1) * PLACES].mean(axis=-1)
    shadow[..., lamps] = lit[..., lamps * PLACES :].mean(axis=-1)
    light = np.empty_like(surfaces.albedo)
    centre = lighting.place_m.mean(axis=1).reshape(-1, 3)
    size2 = ((lighting.place_m - centre[:, None]) ** 2).sum(axis=-1).mean(axis=-1)
    chest2 = ((centre - CHEST_M) ** 2).sum(axis=-1) + size2
    power = lighting.rgb * chest2[:, None]
    a, b, c, d = (array.astype(np.float32) for array in (centre, size2, power, lighting.ambient))
    _shine(surfaces, shadow, _Lamps(a, b, c, d, lighting.sky), light)
    return light


class _Lamps(NamedTuple):
    """Lamps for kernels: centre (L, 3), squared size (L,), power (L, 3); ambient light (3,), its share from
    above.
    """

    centre: Float32
    size2: Float32
    power: Float32
    ambient: Float32
    sky: float


def _lit(surfaces: Surfaces, scene: Mesh, places_m: Float64) -> Float32:
    """Return the share (h/4, w/4, N), in [0, 1], of light from N points (N, 3) that reaches every fourth
    pixel.
    """
    point, normal = (a[::STRIDE, ::STRIDE] for a in (surfaces.point_m, surfaces.normal))
    # A convex room does not shadow itself.
    casts = ~np.isin(scene.tags, (Surface.FLOOR, Surface.WALL))
    faces = np.ascontiguousarray(scene.faces[casts])
    lit = np.ones((*point.shape[:2], len(places_m)), np.float32)
    for n, place in enumerate(places_m):
        pose = look_at(place, CHEST_M)
        seen = rasterize(_MAP_CAMERA, pose.apply(scene.vertices_m).astype(np.float32), faces)
        _look_up(point, normal, (pose.rotation, pose.translation_m), seen.depth_m, lit[..., n])
    return lit


@numba.njit(cache=True, nogil=True, fastmath=EXACT)
def _look_up(
    point: Float32, normal: Float32, pose: tuple[Float64, Float64], depth: Float32, lit: Float32
) -> None:
    """Write into ``lit`` the share of light that reaches points, by bilinear look-up in a shadow map."""
    (r, t), centre = pose, (MAP_PX - 1) / 2
    for v in range(lit.shape[0]):
        for u in range(lit.shape[1]):
            x = point[v, u, 0] + _LIFT_M * normal[v, u, 0]
            y = point[v, u, 1] + _LIFT_M * normal[v, u, 1]
            z = point[v, u, 2] + _LIFT_M * normal[v, u, 2]
            far = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z + t[2]
            if far < 0.1:
                continue
            i = 120.0 * (r[0, 0] * x + r[0, 1] * y + r[0, 2] * z + t[0]) / far + centre
            j = 120.0 * (r[1, 0] * x + r[1, 1] * y + r[1, 2] * z + t[1]) / far + centre
            if not (0 <= i < MAP_PX - 1 and 0 <= j < MAP_PX - 1):
                continue
            i0, j0 = int(i), int(j)
            a, b = i - i0, j - j0
            near = far - _BIAS_M
            # NaN, without a hit, compares false: lit.
            shade = (1 - a) * (1 - b) * (depth[j0, i0] < near) + a * (1 - b) * (depth[j0, i0 + 1] < near)
            shade += (1 - a) * b * (depth[j0 + 1, i0] < near) + a * b * (depth[j0 + 1, i0 + 1] < near)
            lit[v, u] = 1 - shade


@numba.njit(cache=True, nogil=True, fastmath=EXACT)
def _shine(surfaces: Surfaces, shadow: Float32, lamps: _Lamps, light: Float32) -> None:
    """Write the Lambertian light of lamps and walls, times albedo, into ``light`` (h, w, 3)."""
    albedo, normal, point = surfaces
    height, width, _ = albedo.shape
    rows, columns, n = shadow.shape
    open_ = np.empty(n, np.float32)
    for j in range(rows):
        for i in range(columns):
            right, below = min(i + 1, columns - 1), min(j + 1, rows - 1)
            even = True
            for m in range(n):
                open_[m] = shadow[j, i, m]
                even &= shadow[j, right, m] == open_[m]
                even &= (shadow[below, i, m] == open_[m]) & (shadow[below, right, m] == open_[m])
            for v in range(j * STRIDE, min(j * STRIDE + STRIDE, height)):
                for u in range(i * STRIDE, min(i * STRIDE + STRIDE, width)):
                    if not even:
                        _between(point, shadow, (v, u), (j, i, below, right), open_)
                    red, green, blue = _falling(point[v, u], normal[v, u], open_, lamps)
                    light[v, u, 0] = red * albedo[v, u, 0]
                    light[v, u, 1] = green * albedo[v, u, 1]
                    light[v, u, 2] = blue * albedo[v, u, 2]


@numba.njit(cache=True, fastmath=EXACT)
def _between(
    point: Float32, shadow: Float32, pixel: tuple[int, int], cell: tuple[int, int, int, int], open_: Float32
) -> None:
    """Write the share of each lamp's light that reaches a pixel into ``open_``.

    The shares are interpolated from the four corners of the pixel's cell; corners on its surface weigh most.
    """
    (v, u), (j, i, below, right) = pixel, cell
    b, a = (v - j * STRIDE) / STRIDE, (u - i * STRIDE) / STRIDE
    open_[:] = 0
    total = 0.0
    for corner in range(4):
        y, x = below if corner > 1 else j, right if corner % 2 else i
        off = 0.0
        for k in range(3):
            off += (point[y * STRIDE, x * STRIDE, k] - point[v, u, k]) ** 2
        weight = (a if corner % 2 else 1 - a) * (b if corner > 1 else 1 - b) + 1e-3
        weight /= 1 + (off / _ALIKE_M**2) ** 2
        total += weight
        for m in range(len(open_)):
            open_[m] += weight * shadow[y, x, m]
    for m in range(len(open_)):
        open_[m] /= total


@numba.njit(cache=True, fastmath=EXACT, inline="always")
def _falling(at: Float32, normal: Float32, open_: Float32, lit_by: _Lamps) -> tuple[float, float, float]:
    """Return the irradiance (red, green, blue) at a surface point. open_: share of light that arrives from
    each lamp and, last, from the walls.
    """
    lamps, size2, power, ambient, sky = lit_by
    last = len(open_) - 1
    k = np.float32((1 + sky * (normal[2] - 1) / 2) * (BOUNCE_FLOOR + (1 - BOUNCE_FLOOR) * open_[last]))
    red, green, blue = k * ambient[0], k * ambient[1], k * ambient[2]
    for m in range(last):
        dx, dy, dz = lamps[m, 0] - at[0], lamps[m, 1] - at[1], lamps[m, 2] - at[2]
        facing = normal[0] * dx + normal[1] * dy + normal[2] * dz
        if facing > 0 and open_[m] > 0:
            away2 = dx * dx + dy * dy + dz * dz
            k = open_[m] * facing / (np.sqrt(away2) * (away2 + size2[m]) + _TINY)
            red, green, blue = red + k * power[m, 0], green + k * power[m, 1], blue + k * power[m, 2]
    return red, green, blue

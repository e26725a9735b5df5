"""Albedo, normal and position of the surface at every pixel, without light."""

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np

from annotate.array_types import Float32, Float64, Int32, Int64, UInt8
from annotate.scheme.regions import N_REGIONS
from sensors.rig.camera import Intrinsics
from sensors.rig.rig_calibration import Pose
from synth.appearance.outfit import Outfit
from synth.appearance.pattern import (
    FACE,
    FIRST_CLOTH,
    FOOT,
    HAIR,
    HAIRLINE,
    N_ZONES,
    SHOE,
    SKIN,
)
from synth.surface.facets import (
    Triple,
    cross,
    dot,
    edge,
    mix,
    mix_column,
    noise_tile,
    shares,
    smooth_noise,
    unit,
    wavelength_cells,
)
from synth.surface.rasterize import EXACT, Mesh, ZBuffer

# Wavelengths in metres of seams, folds, worn patches and strands of hair; untuned.
_SEAM_CELLS, _FOLD_CELLS, _PATCH_CELLS, _HAIR_CELLS = map(wavelength_cells, (0.12, 0.055, 0.16, 0.008))
_FOLD_STEP_M = 0.004  # of a fold's slope
_SKIN_GRAIN, _HAIR_GRAIN = 0.03, 0.2  # deviations of brightness; untuned

_OnFace = tuple[int, Triple, Triple]
"""Place on a face: face, barycentric coordinates, place in the rest pose."""
_Cut = tuple[int, int, Int32, Float64, Int32]
"""Zone and region of a face, and its wearer's ``beside``, ``side`` and ``openings``."""


class Surfaces(NamedTuple):
    """Images (h, w, 3) of the visible surfaces, 0 without a hit.

    albedo: linear. normal, point_m: world frame.
    """

    albedo: Float32
    normal: Float32
    point_m: Float32


class RoomColors(NamedTuple):
    """Linear colours (T, 3) of furniture by tag.

    grain: (T, 3), contrast of the pattern, cells per metre along x and z, and along y.
    """

    rgb: Float64
    grain: Float64


class _Eye(NamedTuple):
    """Camera: lens (4,) fx, fy, cx, cy; rotation (3, 3) and translation (3,), camera from world."""

    lens: Float64
    rotation: Float64
    translation: Float64


class _Shell(NamedTuple):
    """Vertices (V, 3), faces (F, 3) and tags (F,) of a scene; normals of faces (F, 3) and vertices (V, 3)."""

    vertices: Float32
    faces: Int32
    tags: Int32
    flat: Float32
    rounded: Float32


class _Clothes(NamedTuple):
    """Outfits of all n wearers: arrays by face (F,), by vertex (V,) and by wearer.

    By wearer are the zone colours (n, N_ZONES, 3), the wear (n, 2): ``seam_sd_m``, ``patch``, and the
    patterns' ``beside``, ``side`` and ``openings``.
    """

    wearer: Int64
    zones: UInt8
    regions: UInt8
    rest: Float32
    fields: Float32
    folds: Float32
    colors: Float64
    wear: Float64
    beside: Int32
    side: Float64
    openings: Int32


def _clothes(outfits: Sequence[Outfit]) -> _Clothes:
    """Return the outfits of all wearers in common arrays; patterns with fewer seams are padded."""
    patterns = [outfit.pattern for outfit in outfits]
    fields = max((pattern.n_fields for pattern in patterns), default=0)
    seams = max((pattern.side.shape[1] for pattern in patterns), default=0)
    beside = np.full((len(outfits), N_ZONES, seams, 2), -1, np.int32)
    side = np.ones((len(outfits), N_ZONES, seams))
    for i, pattern in enumerate(patterns):
        own = pattern.side.shape[1]
        beside[i, :, :own], side[i, :, :own] = pattern.beside, pattern.side
    padded = [np.pad(o.fields_m, ((0, 0), (0, fields - o.fields_m.shape[1]))) for o in outfits]
    empty = np.zeros(0, np.uint8)
    return _Clothes(
        np.repeat(np.arange(len(outfits)), [len(o.face_regions) for o in outfits]),
        np.concatenate([empty, *(o.pattern.zone_of_region[o.face_regions] for o in outfits)]),
        np.concatenate([empty, *(o.face_regions for o in outfits)]),
        np.concatenate([np.zeros((0, 3), np.float32), *(o.rest_m for o in outfits)]),
        np.concatenate([np.zeros((0, fields), np.float32), *padded]),
        np.concatenate([np.zeros(0, np.float32), *(o.folds_m for o in outfits)]),
        np.array([o.zone_rgb for o in outfits]).reshape(-1, N_ZONES, 3),
        np.array([(o.seam_sd_m, o.patch) for o in outfits]).reshape(-1, 2),
        beside,
        side,
        np.array([p.openings for p in patterns], np.int32).reshape(-1, N_ZONES, 1 + N_REGIONS),
    )


def paint(
    seen: ZBuffer,
    camera: tuple[Intrinsics, Pose],
    scene: Mesh,
    outfits: Sequence[Outfit],
    room: RoomColors,
) -> Surfaces:
    """Return albedo, smooth normals and positions of the surfaces in a pinhole render of ``scene`` (world
    frame).

    camera: pinhole and camera_from_world. The scene begins with the faces and vertices of the outfits.
    """
    pinhole, pose = camera
    clothes = _clothes(outfits)
    surfaces = Surfaces(*(np.zeros((*seen.face.shape, 3), np.float32) for _ in range(3)))
    flat, rounded = _normals(scene.vertices_m, scene.faces, len(clothes.zones))
    lens = np.array([pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy])
    eye = _Eye(lens, pose.rotation, pose.translation_m)
    shell = _Shell(scene.vertices_m, scene.faces, scene.tags, flat, rounded)
    _paint((seen.face, seen.depth_m, eye), shell, clothes, (*room, noise_tile()), surfaces)
    return surfaces


@numba.njit(cache=True, fastmath=EXACT)
def _normals(vertices: Float32, faces: Int32, smooth: int) -> tuple[Float32, Float32]:
    """Return unit normals (F, 3) of faces, and at vertices (V, 3) unnormalised sums over the first ``smooth``
    faces.
    """
    flat, rounded = np.empty((len(faces), 3), np.float32), np.zeros(vertices.shape, np.float32)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        x, y, z = cross(edge(vertices, a, b), edge(vertices, a, c))
        length = np.sqrt(x * x + y * y + z * z) + 1e-12
        flat[f, 0], flat[f, 1], flat[f, 2] = x / length, y / length, z / length
        if f < smooth:
            for i in range(3):
                rounded[faces[f, i], 0] += x
                rounded[faces[f, i], 1] += y
                rounded[faces[f, i], 2] += z
    return flat, rounded


@numba.njit(cache=True, nogil=True, fastmath=EXACT)
def _paint(
    seen: tuple[Int32, Float32, _Eye],
    shell: _Shell,
    clothes: _Clothes,
    room: tuple[Float64, Float64, Float32],
    surfaces: Surfaces,
) -> None:
    """Fill ``surfaces`` in place: albedo, normal and position at each pixel that shows a face.

    seen: face index (h, w), negative without a face; depth (h, w) in metres; camera. room: colours (T, 3) and
    grain (T, 3) of furniture by tag, noise texture.
    """
    # Unpacked once, because every access in the loops would count references.
    face, depth, (lens, r, translation) = seen
    vertices, faces, tags, flat, rounded = shell
    wearer, own_zones, regions, rest, fields, folds, colors, wear, beside, side, openings = clothes
    room_rgb, grain, tile = room
    skin, cloth = (fields, faces, tile), (vertices, rest, faces, folds, tile)
    albedo, normal, point = surfaces
    height, width = face.shape
    place = -r.T @ translation
    for v in range(height):
        for u in range(width):
            f = face[v, u]
            if f < 0:
                continue
            z = np.float64(depth[v, u])
            x, y = z * (u - lens[2]) / lens[0] - translation[0], z * (v - lens[3]) / lens[1] - translation[1]
            z -= translation[2]
            p = (
                r[0, 0] * x + r[1, 0] * y + r[2, 0] * z,
                r[0, 1] * x + r[1, 1] * y + r[2, 1] * z,
                r[0, 2] * x + r[1, 2] * y + r[2, 2] * z,
            )
            n: Triple = (np.float64(flat[f, 0]), np.float64(flat[f, 1]), np.float64(flat[f, 2]))
            if f < len(own_zones):
                share = shares(vertices, faces, f, p)
                q, w = mix(rest, faces, f, share), wearer[f]
                n = unit(mix(rounded, faces, f, share))
                cut = (own_zones[f], regions[f], beside[w], side[w], openings[w])
                rgb, is_cloth = _clothed(skin, (f, share, q), cut, colors[w], wear[w])
                if is_cloth and folds[faces[f, 0]] > 0:
                    n = _folded(n, cloth, (f, share, q))
            else:
                tag = tags[f]
                # The normal turns to the camera at ``place``, because both sides of furniture are visible.
                if n[0] * (p[0] - place[0]) + n[1] * (p[1] - place[1]) + n[2] * (p[2] - place[2]) > 0:
                    n = (-n[0], -n[1], -n[2])
                bright = 1.0
                if grain[tag, 0] > 0:
                    a, b = grain[tag, 1], grain[tag, 2]
                    bright += grain[tag, 0] * smooth_noise(tile, a * p[0], b * p[1], a * p[2])
                rgb = (bright * room_rgb[tag, 0], bright * room_rgb[tag, 1], bright * room_rgb[tag, 2])
            for i in range(3):
                albedo[v, u, i], normal[v, u, i], point[v, u, i] = rgb[i], n[i], p[i]


@numba.njit(cache=True, fastmath=EXACT)
def _clothed(
    skin: tuple[Float32, Int32, Float32], place: _OnFace, cut: _Cut, zones: Float64, wear: Float64
) -> tuple[Triple, bool]:
    """Return the linear colour at a point of a body's skin, and True if cloth covers it."""
    (fields, faces, tile), (f, share, q) = skin, place
    stray = 0.0
    if wear[0] > 0:
        stray = wear[0] * _noise(tile, q, _SEAM_CELLS)
    zone = _zone(fields, faces, (f, share), cut, stray)
    is_cloth = zone >= FIRST_CLOTH
    bright, grey = 1.0, 0.0
    if zone == HAIR:
        c = _HAIR_CELLS
        bright += _HAIR_GRAIN * smooth_noise(tile, c * q[0], c * q[1], 0.2 * _HAIR_CELLS * q[2])
    elif zone == SKIN:
        bright += _SKIN_GRAIN * _noise(tile, q, _PATCH_CELLS)
    elif wear[1] > 0:
        worn = _noise(tile, (q[1], q[2], q[0]), _PATCH_CELLS)
        bright += wear[1] * worn
        grey = wear[1] * max(worn, 0.0)
    a, b, c = zones[zone, 0], zones[zone, 1], zones[zone, 2]
    mean = grey * (a + b + c) / 3
    keep = 1 - grey
    return (bright * (keep * a + mean), bright * (keep * b + mean), bright * (keep * c + mean)), is_cloth


@numba.njit(cache=True, fastmath=EXACT)
def _zone(fields: Float32, faces: Int32, place: tuple[int, Triple], cut: _Cut, stray: float) -> int:
    """Return the zone at a point of a face. stray: offset in metres, from noise, added to the fields."""
    (f, share), (own, region, beside, side, openings) = place, cut
    zone = int(own)
    for k in range(beside.shape[1]):
        seam = beside[own, k, 0]
        if seam < 0:
            break
        if side[own, k] * (mix_column(fields, seam, faces, f, share) + stray) > 0:
            zone = int(beside[own, k, 1])
            break
    opening = openings[zone, region]
    if opening < 0 or not mix_column(fields, opening, faces, f, share) + stray > 0:
        return zone
    if opening == FOOT:
        return SHOE
    if opening == FACE and mix_column(fields, HAIRLINE, faces, f, share) + stray > 0:
        return HAIR
    return SKIN


@numba.njit(cache=True, fastmath=EXACT)
def _folded(n: Triple, cloth: tuple[Float32, Float32, Int32, Float32, Float32], place: _OnFace) -> Triple:
    """Return the normal ``n`` tilted by the slope of folds, whose heights are noise over the rest pose."""
    (vertices, rest, faces, folds, tile), (f, share, q) = cloth, place
    a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
    height = share[0] * folds[a] + share[1] * folds[b] + share[2] * folds[c]
    first, second = edge(vertices, a, b), edge(vertices, a, c)
    along = cross(first, second)
    area = dot(along, along)
    if area < 1e-16:
        return n
    here = _ridge(tile, q)
    d1 = height * _rise(tile, q, here, edge(rest, a, b))
    d2 = height * _rise(tile, q, here, edge(rest, a, c))
    g, k = cross(second, along), cross(along, first)
    return unit(
        (
            n[0] - (d1 * g[0] + d2 * k[0]) / area,
            n[1] - (d1 * g[1] + d2 * k[1]) / area,
            n[2] - (d1 * g[2] + d2 * k[2]) / area,
        )
    )


@numba.njit(cache=True, fastmath=EXACT)
def _rise(tile: Float32, q: Triple, here: float, edge: Triple) -> float:
    """Return the slope of folds of height 1 at rest point ``q`` along an edge. here: noise at ``q``."""
    step = _FOLD_STEP_M / (np.sqrt(dot(edge, edge)) + 1e-9)
    there = _ridge(tile, (q[0] + step * edge[0], q[1] + step * edge[1], q[2] + step * edge[2]))
    slope: float = (there - here) / step
    return slope


@numba.njit(cache=True, fastmath=EXACT)
def _ridge(tile: Float32, q: Triple) -> float:
    c = _FOLD_CELLS
    return smooth_noise(tile, c * q[0], c * q[1], 1.6 * c * q[2])


@numba.njit(cache=True, fastmath=EXACT)
def _noise(tile: Float32, q: Triple, cells: float) -> float:
    return smooth_noise(tile, cells * q[0], cells * q[1], cells * q[2])

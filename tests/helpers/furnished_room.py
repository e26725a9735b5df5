"""A furnished room with standing people before a depth camera."""

from dataclasses import replace
from functools import cache

import numpy as np

from annotate.cloud.thermal_cloud import ThermalCloud
from sensors.rig.camera import Intrinsics, rays
from synth.body.crowd import crowd
from synth.pose.standing import stand
from synth.pose.standing_parameters import draw_standing
from synth.surface.furniture import Chair, Sofa
from synth.surface.rasterize import Mesh, look_at, merge, rasterize
from synth.surface.room import PLAIN_ROOM

CAMERA = Intrinsics(320, 264, 229.0, 229.0, 159.5, 131.5)


def cloud_of(depth_m, camera=CAMERA, celsius=None):
    depth_mm = np.rint(np.nan_to_num(depth_m) * 1000).astype(np.uint16)
    metres = np.where(depth_mm > 0, depth_mm / 1000, np.nan)
    points = (rays(camera) * metres[..., None]).astype(np.float32)
    nothing = np.zeros((*camera.shape, 3), np.uint8)
    felt = np.full(camera.shape, np.nan) if celsius is None else np.where(depth_mm > 0, celsius, np.nan)
    return ThermalCloud(camera, depth_mm, points, nothing, depth_mm > 0, felt.astype(np.float32))


@cache
def standing(number):
    """A person of the crowd, tag ``number``."""
    body = crowd()[number]
    vertices = stand(body, draw_standing(np.random.default_rng(number))).vertices_m
    return Mesh(vertices, body.faces, np.full(len(body.faces), number, np.int32))


def seen(people, *, room=True, camera=CAMERA, eye=(0.3, -2.4, 1.4), seed=0):
    """Depth (h, w) with noise, and who is where: people are (number, x)."""
    meshes = [standing(number).placed(np.eye(3), np.array([x, 0.0, 0.0])) for number, x in people]
    if room:
        rng = np.random.default_rng(3)
        things = [Sofa.sample(rng).mesh(), Chair.sample(rng).mesh()]
        places = [(-1.7, 1.5, 0.0), (1.6, 0.6, 0.0)]
        furniture = [
            PLAIN_ROOM.mesh(2.6),
            *(t.placed(np.eye(3), np.array(p)) for t, p in zip(things, places, strict=True)),
        ]
        meshes += [replace(mesh, tags=np.zeros(len(mesh.faces), np.int32)) for mesh in furniture]
    whole = merge(meshes)
    points = look_at(np.array(eye), np.array([0.0, 0.0, 0.95])).apply(whole.vertices_m).astype(np.float32)
    image = rasterize(camera, points, whole.faces)
    depth = image.depth_m + np.random.default_rng(seed).normal(0, 0.003, camera.shape)
    return np.where(depth < 6, depth, np.nan), np.append(whole.tags, 0)[image.face]


def celsius_of(whose, seed=0, person_c=30.0):
    """Degrees (h, w) of a room at 20.5, and of the people in it, who are unevenly warm."""
    rng = np.random.default_rng(seed)
    uneven = np.kron(rng.normal(0, 1, (33, 40)), np.ones((8, 8)))[: whose.shape[0], : whose.shape[1]]
    return np.where(whose > 0, person_c + uneven, 20.5) + rng.normal(0, 0.08, whose.shape)

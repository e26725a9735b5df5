"""One synthetic depth image with part labels: a pure function of (preset, seed, index)."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annotate.crop import SIZE, crop_around
from annotate.labels import FrameLabels
from annotate.parts import N_CLASSES, PART_ID
from annotate.registration import KINECT2_DEPTH
from sensors.errors import CloudError
from synth.body import Body, shipped_bodies
from synth.motion import ACTIVITIES, Sitting, draw, glide, sit
from synth.noise import DepthNoise, kinect
from synth.render import Mesh, ZBuffer, merge, rasterize
from synth.scene import Sofa, look_at
from synth.skeleton import JOINT_ID, Float64

@dataclass(frozen=True)
class Preset:
    """A dataset by name: how many images by default, and which random stream it draws from."""

    name: str
    count: int
    stream: int


PRESETS = {
    preset.name: preset
    for preset in (Preset("sitting-train", 10_076, 1), Preset("sitting-test", 4_984, 2))
}
"""The paper's sitting sets (sections 3.2 and 4.1); their streams never meet."""


def preset_named(name: str) -> Preset:
    """The preset of that name. Raises CloudError naming those there are."""
    if name not in PRESETS:
        raise CloudError(f"preset {name!r} is unknown; use one of {', '.join(PRESETS)}")
    return PRESETS[name]


@dataclass(frozen=True)
class View:
    """A rendered person before any noise.

    zbuffer: as ``rasterize`` gives it. tags: int32 (h, w), part ids or ``Surface``, 0 = nothing.
    dark: bool (h, w), hair. joints_m: (J, 3), camera frame.
    """

    zbuffer: ZBuffer
    tags: NDArray[np.int32]
    dark: NDArray[np.bool_]
    joints_m: Float64


def sample(preset: Preset, seed: int, index: int) -> FrameLabels:
    """Image ``index`` of a preset: the person's crop, 212 x 212, depth in millimetres, parts, provenance."""
    rng = np.random.default_rng((preset.stream, seed, index))
    body, who = _random_body(rng)
    sofa = Sofa.sample(rng)
    activity, moment = _random_moment(rng)
    vertices, joints = sit(body, sofa, moment)
    view = _random_view(rng, body, sofa, vertices, joints)
    person = (view.tags > 0) & (view.tags < N_CLASSES)
    if person.sum() < 400:
        raise AssertionError(f"sample {preset.name}/{seed}/{index} shows no person")
    crop = crop_around(person)
    window = np.s_[
        max(crop.top - 4, 0) : crop.top + crop.side + 4, max(crop.left - 4, 0) : crop.left + crop.side + 4
    ]
    top, left = window[0].start, window[1].start
    inside = replace(crop, top=crop.top - top, left=crop.left - left)
    depth_mm = kinect(
        KINECT2_DEPTH, view.zbuffer.depth_m[window], view.dark[window], DepthNoise.sample(rng), rng, top, left
    )
    parts = np.where(person, view.tags, 0).astype(np.uint8)[window]
    depth = inside.cut(np.where(parts > 0, depth_mm, 0).astype(np.uint16), 0, SIZE)
    labels = np.where(depth > 0, inside.cut(parts, 0, SIZE), 0).astype(np.uint8)
    notes = {
        "activity": activity,
        "crop": [crop.top, crop.left, crop.side],
        "joints_mm": np.rint(view.joints_m * 1000).astype(int).tolist(),
    }
    return FrameLabels(f"{index:08d}", depth, labels, subject=who, status="truth", notes=notes)


def render_view(body: Body, vertices_m: NDArray[np.float32], joints_m: Float64, around: list[Mesh], eye: Float64,
                target: Float64, roll_rad: float = 0.0) -> View:  # fmt: skip
    """Render a posed body among other meshes with the Kinect's pinhole; all in the world frame."""
    camera_from_world = look_at(eye, target, roll_rad)
    person = Mesh(vertices_m, body.faces, body.face_parts.astype(np.int32))
    scene = merge([person, *around])
    in_camera = camera_from_world.apply(scene.vertices_m).astype(np.float32)
    seen = rasterize(KINECT2_DEPTH.undistorted(), in_camera, scene.faces)
    hit = seen.face >= 0
    tags = np.where(hit, scene.tags[np.maximum(seen.face, 0)], 0).astype(np.int32)
    dark = hit & np.concatenate([hair_faces(body), np.zeros(len(scene.faces) - len(body.faces), bool)])[seen.face]
    return View(seen, tags, dark, camera_from_world.apply(joints_m))


def hair_faces(body: Body) -> NDArray[np.bool_]:
    """Faces (F,) where hair grows: the head above the brow, and its back down to the neck."""
    _, y, z = body.vertices_m[body.faces].mean(axis=1).T
    head = body.joints_m[JOINT_ID["head"]]
    top = body.vertices_m[:, 2].max()
    above = z > head[2] + 0.6 * (top - head[2])
    behind = (y > head[1] + 0.02) & (z > head[2])
    return (body.face_parts == PART_ID["head"]) & (above | behind)


def _random_body(rng: np.random.Generator) -> tuple[Body, str]:
    """A build between two of the paper's bodies (same topology, so shapes blend)."""
    bodies = shipped_bodies()
    i, j = rng.choice(len(bodies), 2, replace=False)
    share = float(rng.beta(0.6, 0.6))
    a, b = bodies[i], bodies[j]
    blended = replace(
        a,
        vertices_m=((1 - share) * a.vertices_m + share * b.vertices_m).astype(np.float32),
        joints_m=(1 - share) * a.joints_m + share * b.joints_m,
        face_parts=a.face_parts if share < 0.5 else b.face_parts,
    )
    return blended, (a if share < 0.5 else b).name


def _random_moment(rng: np.random.Generator) -> tuple[str, Sitting]:
    names = tuple(ACTIVITIES)
    first = str(rng.choice(names))
    second = first if rng.random() < 0.6 else str(rng.choice(names))
    return first, glide(draw(first, rng), draw(second, rng), float(rng.random()))


def _random_view(
    rng: np.random.Generator, body: Body, sofa: Sofa, vertices: NDArray[np.float32], joints: Float64
) -> View:
    """The robot's view: within 65 degrees of the front, at chest to head height of a standing person."""
    centre = vertices.mean(axis=0).astype(np.float64)
    azimuth, distance = np.radians(rng.uniform(-65, 65)), rng.uniform(1.3, 3.0)
    eye = centre + distance * np.array([np.sin(azimuth), -np.cos(azimuth), 0])
    eye[2] = rng.uniform(0.6, 1.7)
    target = centre + rng.normal(0, (0.12, 0.12, 0.10))
    return render_view(body, vertices, joints, [sofa.mesh()], eye, target, np.radians(rng.normal(0, 2)))

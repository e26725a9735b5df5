"""Making samples, beside Open3D's ray caster in the same run.

The naive way casts a ray per pixel of the same frames. Memory of a worker and bytes an image go to stderr.
Blender is not a dependency: its row was measured once.
"""

import resource
import tempfile
import time
from pathlib import Path

import numpy as np
import open3d as o3d
from rich.console import Console

from sensors.calibration_files.kinect2_factory import KINECT2_PINHOLE
from sensors.rig.camera import rays
from synth.images.generate import Order, generate
from synth.images.people import crowd_person, paper_person
from synth.images.posed_scenes import everybody, recumbent, sitting
from synth.images.presets import PRESETS
from synth.images.view import render_view
from synth.images.workers import processes
from synth.surface.rasterize import rasterize

IMAGES = 2048
WORKERS = 2
SETS = ("sitting-train", "recumbent", "standing", "people")
"""Naked people in front of a Kinect v2; then dressed people through drawn sensors."""
BLENDER_S = 1 / 6.6
"""Seconds of Blender 5.0.1 (bpy) for the depth of one posed body: Cycles, 1 sample, emission materials, depth
pass to EXR, 512 x 424, two cores; measured once."""


def scenes(sample, people=paper_person, number=24):
    """Return (dressed person, draped vertices, things around, camera pose) of each scene."""
    rng = np.random.default_rng(0)
    dressed, made = people(rng).dressed, []
    for _ in range(number):
        drawn = sample(rng, dressed.body)
        shot = drawn.view(rng, drawn.vertices_m, drawn.joints_m, KINECT2_PINHOLE)
        draped = dressed.drape(drawn.vertices_m, drawn.joints_m)
        made.append((dressed, draped, drawn.around, shot.camera_from_world))
    return made


def in_camera(scene):
    """Return the draped vertices (V, 3) of a scene of ``scenes`` in the camera frame."""
    return scene[3].apply(scene[1]).astype(np.float32)


def per_item(call, items):
    """Return the wall time of a call in seconds, without the first call, which compiles."""
    call(items[0])
    start = time.perf_counter()
    for item in items:
        call(item)
    return (time.perf_counter() - start) / len(items)


def ray_cast(faces):
    """Return a function that renders vertices with Open3D: depth and faces, 512 x 424 pixels, all cores."""
    directions = rays(KINECT2_PINHOLE).astype(np.float32)
    all_rays = o3d.core.Tensor(np.concatenate([np.zeros_like(directions), directions], axis=2))

    def cast(vertices):
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(vertices, faces.astype(np.uint32))
        return scene.cast_rays(all_rays)

    return cast


def finished(name):
    """Return the seconds and bytes of a finished sample: pose, skin, render, noise, crop, encode, write."""
    with tempfile.TemporaryDirectory() as folder, processes(WORKERS) as workers:
        # The workers start and load compiled code first, as in any run that is long enough to matter.
        warm_up = Order(PRESETS[name], 2 * WORKERS * 16, 1, shard_frames=16)
        generate(warm_up, Path(folder) / "warm", workers, lambda n: None)
        start = time.perf_counter()
        generate(Order(PRESETS[name], IMAGES, 0), Path(folder) / "set", workers, lambda n: None)
        seconds = (time.perf_counter() - start) / IMAGES
        size = sum(path.stat().st_size for path in (Path(folder) / "set").glob("*.tar")) / IMAGES
    return seconds, size


def bench() -> list[tuple[str, float, float]]:
    """Return rows (name, seconds an image, seconds of Open3D's ray caster for its depth alone)."""
    seated = scenes(sitting)
    faces, points = seated[0][0].faces, [in_camera(scene) for scene in seated]
    cast = per_item(ray_cast(faces), points[:6])
    rows = [
        (
            "depth + faces, 512x424, one core",
            per_item(lambda p: rasterize(KINECT2_PINHOLE, p, faces, True), points),
            cast,
        )
    ]
    dressed = scenes(everybody, crowd_person)
    for made, name in ((seated, "seated"), (scenes(recumbent), "recumbent"), (dressed, "dressed")):
        seconds = per_item(lambda s: render_view(*s, KINECT2_PINHOLE), made)
        rows.append((f"depth + labels of the window, {name}, one core", seconds, cast))
    sizes = []
    for name in SETS:
        seconds, size = finished(name)
        sizes.append(f"{name} {size:.0f} bytes an image")
        rows.append((f"finished samples, {name}, {WORKERS} workers", seconds, cast))
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    Console(stderr=True).print(f"peak memory of a worker {peak:.0f} MiB; {', '.join(sizes)}")
    return [*rows, ("depth, 512x424, Blender Cycles, two cores, measured once", BLENDER_S, cast)]

"""Files of the person finder's training images, one for each seed: ``KIND_SEED.npz``."""

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import numpy as np

from annotate.array_types import UInt8
from eval.training.finder.images import FIRST_THING, STORED_FOCAL_PX, Image, SceneImages
from eval.training.rooms.close_rooms import close_scenes
from eval.training.rooms.empty_rooms import empty_scenes
from eval.training.rooms.scenes import Scene, rig_scenes, room_scenes
from sensors.files.atomic import replacing
from synth.images.workers import processes

KINDS = ("rig", "room", "close", "empty")  # in the order of ``SceneImages``


def store_scenes(folder: Path, counts: Mapping[str, int], first: int = 1, workers: int = 1) -> None:
    """Write the missing files of training images, in ``workers`` processes.

    counts: number of seeds by kind; a seed is a recording of the rig, or a group of rooms. first: the first
    seed.
    """
    named = [(kind, seed) for kind, count in counts.items() for seed in range(first, first + count)]
    missing = [(kind, seed) for kind, seed in named if not _file(folder, kind, seed).exists()]
    write = partial(_write, folder)
    with processes(workers) if workers > 1 and missing else nullcontext() as pool:
        for _ in pool.executor.map(write, missing) if pool else map(write, missing):
            pass


def _file(folder: Path, kind: str, seed: int) -> Path:
    return folder / f"{kind}_{seed:06d}.npz"


def _write(folder: Path, kind_and_seed: tuple[str, int]) -> None:
    kind, seed = kind_and_seed
    scenes: dict[str, Callable[[int], Iterable[Scene]]] = {
        "rig": rig_scenes, "room": room_scenes, "close": close_scenes, "empty": empty_scenes
    }  # fmt: skip
    arrays = {
        f"{name}{i}": array
        for i, scene in enumerate(scenes[kind](seed))
        for name, array in zip("dwp", image_of(scene), strict=True)
    }
    with replacing(_file(folder, kind, seed)) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)  # type: ignore[arg-type]


def load_scenes(folder: Path) -> SceneImages:
    """Return all images that ``store_scenes`` wrote."""
    with ThreadPoolExecutor() as pool:
        files = (pool.map(_loaded, sorted(folder.glob(f"{kind}_*.npz"))) for kind in KINDS)
        return SceneImages(*([image for images in kind for image in images] for kind in files))


def _loaded(path: Path) -> list[Image]:
    with np.load(path) as arrays:
        count = len(arrays.files) // 3
        return [(arrays[f"d{i}"], arrays[f"w{i}"], arrays[f"p{i}"]) for i in range(count)]


def image_of(scene: Scene) -> Image:
    """Return a scene resampled to the focal length ``STORED_FOCAL_PX``."""
    scale = STORED_FOCAL_PX / scene.camera.fx
    v, u = (
        np.minimum(((np.arange(round(side * scale)) + 0.5) / scale).astype(int), side - 1)
        for side in scene.depth_mm.shape
    )
    small = np.ix_(v, u)
    return scene.depth_mm[small], scene.warmth[small].astype(np.float16), _surfaces(scene)[small]


def _surfaces(scene: Scene) -> UInt8:
    """Return the surfaces of ``Image``."""
    if scene.things is None:
        return scene.persons
    things = scene.things.clip(max=255 - FIRST_THING)
    numbers = np.where(things > 0, things + np.uint8(FIRST_THING), np.uint8(0))
    return np.where(scene.persons > 0, scene.persons, numbers)

"""Generation of dataset shards on any executor, resumable; the bytes do not depend on the workers."""

import hashlib
import json
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from annotate.labelset.cast_note import cast_note
from annotate.labelset.claim import Claim, login
from annotate.labelset.dataset import MANIFEST, ORDER, SCHEMA, Dataset, encode_shard, sha256
from annotate.labelset.scheme_note import scheme_note
from sensors.errors import CloudError, ExistsError, Setting
from sensors.files.atomic import is_taken, write_bytes
from sensors.versions import code_digest, different, versions
from synth.images.dataset_page import write_page
from synth.images.distributions import Distributions
from synth.images.people import Wardrobe
from synth.images.posed_scenes import MotionScenes
from synth.images.presets import Preset, sample
from synth.images.workers import Workers
from synth.own_camera import OwnCamera


def _versions() -> dict[str, str]:
    """Return versions of libraries and code, which affect the bytes of a dataset."""
    decisive = ("annotate-cloud", "numpy", "numba", "opencv-contrib-python-headless")
    return versions(decisive) | {"code": code_digest("sensors", "annotate", "synth")}


@dataclass(frozen=True)
class Order:
    """Specification of a dataset; its fields determine every byte."""

    preset: Preset
    count: int
    seed: int
    shard_frames: int = 256
    versions: dict[str, str] = field(default_factory=_versions)

    def __post_init__(self) -> None:
        if not 1 <= self.count <= 1_000_000_000:
            raise CloudError(f"count {self.count} is impossible; give 1 to 1000000000 images")
        if not 0 <= self.seed < 2**63:
            raise CloudError(f"seed {self.seed} is impossible; give 0 to 2^63 - 1")

    @property
    def shards(self) -> int:
        """Return the number of shards."""
        return -(-self.count // self.shard_frames)

    def frames(self, shard: int) -> range:
        """Return the indices of the images in a shard."""
        first = shard * self.shard_frames
        return range(first, min(first + self.shard_frames, self.count))

    def manifest(self) -> dict[str, Any]:
        """Return the specification as JSON values."""
        scene = self.preset.scene
        return {
            "preset": self.preset.name,
            **cast_note(self.preset.cast),
            **scheme_note(self.preset.scheme),
            **({"camera": own.manifest()} if isinstance(own := self.preset.sensor, OwnCamera) else {}),
            **({"motion": scene.repertoire.manifest()} if isinstance(scene, MotionScenes) else {}),
            "occluders": self.preset.occluders,
            "cut": self.preset.cut,
            "images": self.count,
            "seed": self.seed,
            "shard_frames": self.shard_frames,
            "versions": self.versions,
            **({"garments": people.sha256} if isinstance(people := self.preset.people, Wardrobe) else {}),
        }


class Made(NamedTuple):
    """Finished dataset, and the number of images that this run generated."""

    dataset: Dataset
    images: int


def make_shard(order: Order, shard: int) -> bytes:
    """Return one shard's bytes. Raises CloudError on a worker whose library versions differ from the
    order's.
    """
    if (here := _versions()) != order.versions:
        raise CloudError(
            f"a worker has {different(here, order.versions)}; install the same versions everywhere"
        )
    return encode_shard(sample(order.preset, order.seed, i) for i in order.frames(shard))


def generate(
    order: Order,
    out: Path,
    workers: Workers,
    progress: Callable[[int], None],
    beside: Distributions | None = None,
) -> Made:
    """Write the missing shards, then manifest and page, into ``out``.

    progress: called with the number of images done. beside: distributions of real people, for the page.
    Raises ExistsError if ``out`` does not hold the beginning of this order, ClaimedError while another
    process generates it.
    """
    _begin(order, out)
    with Claim.take(out, login()):
        missing = [i for i in range(order.shards) if not (out / _file(i)).is_file()]
        made = sum(len(order.frames(i)) for i in missing)
        progress(order.count - made)
        hashes = _make(order, out, missing, workers, progress)
        return Made(_finish(order, out, hashes, beside), made)


def _make(
    order: Order, out: Path, missing: list[int], workers: Workers, progress: Callable[[int], None]
) -> dict[int, str]:
    """Write the missing shards and return their SHA-256 by number."""
    hashes: dict[int, str] = {}
    futures: dict[Future[bytes], int] = {}
    queue = iter(missing)
    try:
        while True:
            # Two tasks a worker keep the worker busy and the parent's memory small.
            while len(futures) < 2 * workers.parallel and (shard := next(queue, None)) is not None:
                futures[workers.executor.submit(make_shard, order, shard)] = shard
            if not futures:
                return hashes
            finished = wait(futures, return_when=FIRST_COMPLETED).done
            # Finished shards first, because a lost worker raises.
            for done in sorted(finished, key=lambda future: future.exception() is not None):
                shard, data = futures.pop(done), done.result()
                write_bytes(out / _file(shard), data)
                hashes[shard] = hashlib.sha256(data).hexdigest()
                progress(len(order.frames(shard)))
    finally:
        for future in futures:
            future.cancel()


def _begin(order: Order, out: Path) -> None:
    """Write the order file, or check that a half-finished folder holds the same order. Raises ExistsError."""
    started = out / ORDER
    text = (json.dumps(order.manifest(), sort_keys=True) + "\n").encode()
    if is_taken(out):
        if not started.is_file() or started.read_bytes() != text:
            raise ExistsError(
                f"{out} holds another dataset or other files; choose another folder", Setting.OVERWRITE
            )
        return
    out.mkdir(parents=True, exist_ok=True)
    write_bytes(started, text)


def _finish(order: Order, out: Path, hashes: dict[int, str], beside: Distributions | None) -> Dataset:
    shards = [
        {"file": _file(i), "sha256": hashes.get(i) or sha256(out / _file(i))} for i in range(order.shards)
    ]
    manifest = {"schema": SCHEMA, **order.manifest(), "shards": shards}
    write_bytes(out / MANIFEST, (json.dumps(manifest, indent=1, sort_keys=True) + "\n").encode())
    dataset = Dataset.open(out)
    write_page(dataset, beside)
    return dataset


def _file(shard: int) -> str:
    return f"shard-{shard:06d}.tar"

"""Seeds to shards on any executor; the bytes do not depend on the workers, and a broken run resumes."""

import json
from collections.abc import Callable
from concurrent.futures import Executor, Future, as_completed
from dataclasses import dataclass
from pathlib import Path

from sensors.atomic import write_bytes
from sensors.errors import CloudError, ExistsError
from synth.dataset import MANIFEST, SCHEMA, Dataset, encode_shard, sha256
from synth.sample import Preset, preset_named, sample

SHARD_FRAMES = 256


@dataclass(frozen=True)
class Order:
    """What to generate: these fields decide every byte."""

    preset: Preset
    count: int
    seed: int

    def __post_init__(self) -> None:
        if not 1 <= self.count <= 1_000_000_000:
            raise CloudError(f"count {self.count} is impossible; give 1 to 1000000000 images")

    @property
    def shards(self) -> int:
        """Number of shards, the last one perhaps shorter."""
        return -(-self.count // SHARD_FRAMES)

    def manifest(self) -> dict[str, str | int]:
        """The order as JSON values."""
        return {"preset": self.preset.name, "images": self.count, "seed": self.seed, "shard_frames": SHARD_FRAMES}


def make_shard(preset_name: str, seed: int, count: int, shard: int) -> bytes:
    """One shard's bytes: the pure function that workers run."""
    preset = preset_named(preset_name)
    first = shard * SHARD_FRAMES
    return encode_shard(sample(preset, seed, i) for i in range(first, min(first + SHARD_FRAMES, count)))


def generate(order: Order, out: Path, executor: Executor, progress: Callable[[int], None]) -> Dataset:
    """Write the dataset's missing shards and its manifest into ``out``; ``progress`` gets images done.

    Raises ExistsError when ``out`` holds something else than the beginning of this very order.
    """
    _claim(order, out)
    missing = [i for i in range(order.shards) if not (out / _file(i)).is_file()]
    progress(order.count - sum(_length(order, i) for i in missing))
    futures: dict[Future[bytes], int] = {}
    queue = iter(missing)
    try:
        # A bounded number in flight keeps the parent's memory flat.
        while len(futures) < 8 and (shard := next(queue, None)) is not None:
            futures[_submit(executor, order, shard)] = shard
        while futures:
            done = next(as_completed(futures))
            shard = futures.pop(done)
            write_bytes(out / _file(shard), done.result())
            progress(_length(order, shard))
            if (following := next(queue, None)) is not None:
                futures[_submit(executor, order, following)] = following
    finally:
        for future in futures:
            future.cancel()
    return _finish(order, out)


def _submit(executor: Executor, order: Order, shard: int) -> "Future[bytes]":
    return executor.submit(make_shard, order.preset.name, order.seed, order.count, shard)


def _claim(order: Order, out: Path) -> None:
    """Start or resume: the order file says whose half-finished folder this is."""
    started = out / "order.json"
    text = (json.dumps(order.manifest(), sort_keys=True) + "\n").encode()
    if out.exists() and any(out.iterdir()):
        if not started.is_file() or started.read_bytes() != text:
            raise ExistsError(f"{out} holds something else already; choose another folder or pass --overwrite")
        return
    out.mkdir(parents=True, exist_ok=True)
    write_bytes(started, text)


def _finish(order: Order, out: Path) -> Dataset:
    shards = [{"file": _file(i), "sha256": sha256(out / _file(i))} for i in range(order.shards)]
    manifest = {"schema": SCHEMA, **order.manifest(), "shards": shards}
    write_bytes(out / MANIFEST, (json.dumps(manifest, indent=1, sort_keys=True) + "\n").encode())
    return Dataset.open(out)


def _file(shard: int) -> str:
    return f"shard-{shard:06d}.tar"


def _length(order: Order, shard: int) -> int:
    return min(SHARD_FRAMES, order.count - shard * SHARD_FRAMES)

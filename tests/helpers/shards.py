"""A dataset on disk as `synth generate` leaves it, of any frames."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

from annotate.frame_labels import FrameLabels
from annotate.labelset.dataset import MANIFEST, SCHEMA, Dataset, encode_shard


def write_dataset(
    path: Path, frames: Sequence[FrameLabels], per_shard: int = 100, images: int | None = None
) -> Dataset:
    """images: how many the manifest claims, by default as many as there are."""
    path.mkdir()
    shards = []
    for start in range(0, len(frames), per_shard):
        data = encode_shard(frames[start : start + per_shard])
        name = f"shard-{start:06d}.tar"
        (path / name).write_bytes(data)
        shards.append({"file": name, "sha256": hashlib.sha256(data).hexdigest()})
    claimed = len(frames) if images is None else images
    (path / MANIFEST).write_text(json.dumps({"schema": SCHEMA, "images": claimed, "shards": shards}))
    return Dataset.open(path)

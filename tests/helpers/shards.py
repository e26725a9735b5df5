"""A dataset on disk as `synth generate` leaves it, of any frames."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from annotate.frame_labels import FrameLabels
from annotate.labelset.dataset import MANIFEST, SCHEMA, Dataset, encode_shard
from annotate.labelset.scheme_note import scheme_note


def write_dataset(
    path: Path,
    frames: Sequence[FrameLabels],
    per_shard: int = 100,
    images: int | None = None,
    info: Mapping[str, Any] | None = None,
) -> Dataset:
    """images: how many the manifest claims, by default as many as there are. info: other entries."""
    path.mkdir()
    shards = []
    for start in range(0, len(frames), per_shard):
        data = encode_shard(frames[start : start + per_shard])
        name = f"shard-{start:06d}.tar"
        (path / name).write_bytes(data)
        shards.append({"file": name, "sha256": hashlib.sha256(data).hexdigest()})
    claimed = len(frames) if images is None else images
    manifest = {"schema": SCHEMA, "images": claimed, "shards": shards, **(info or {})}
    manifest |= scheme_note(frames[0].scheme) if frames else {}
    (path / MANIFEST).write_text(json.dumps(manifest))
    return Dataset.open(path)

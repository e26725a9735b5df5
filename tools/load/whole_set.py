"""What evaluating the paper's own set costs: ``python -m tools.load.whole_set FOLDER [--images N]``.

326,984 images (Nishi & Miura 2017), every one read, counted and kept. They are those of one shard of
``recumbent`` again and again under their own ids, each sixth pixel of them: 36 x 36, for 212 x 212 takes an
hour. The prediction is the truth with each part a pixel too far to the right within the person.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from annotate.crop import SIZE, Crop
from annotate.frame_labels import FrameLabels
from annotate.labelset import dataset
from annotate.labelset.dataset import Dataset, encode_shard
from annotate.parts import BACKGROUND
from tools.load.material import SHARD, renamed
from tools.load.measure import run

IMAGES = 326_984
SIDE = 36
"""Pixels of an image's side."""


def small(frame: FrameLabels) -> FrameLabels:
    """A frame of fewer pixels, whose notes stay true: they are of the whole image."""
    whole = Crop(0, 0, SIZE)
    depth_mm, parts = (whole.cut(image, 0, SIDE) for image in (frame.depth_mm, frame.parts))
    return replace(frame, depth_mm=depth_mm, parts=parts)


def predicted(frame: FrameLabels) -> FrameLabels:
    """The truth, with the part of the left neighbour in every pixel of the person whose neighbour has one."""
    left = np.roll(frame.parts, 1, axis=1)
    both = (left != BACKGROUND) & (frame.parts != BACKGROUND)
    return replace(frame, parts=np.where(both, left, frame.parts), status="auto")


def long_set(frames: Sequence[FrameLabels], out: Path, images: int) -> None:
    """A finished dataset of these frames again and again."""
    out.mkdir()
    shards = []
    whole, rest = encode_shard(frames), encode_shard(frames[: images % len(frames)])
    for first in range(0, images, len(frames)):
        path = out / f"shard-{first // len(frames):06d}.tar"
        path.write_bytes(renamed(whole if first + len(frames) <= images else rest, first))
        shards.append({"file": path.name, "sha256": dataset.sha256(path)})
    manifest = {"schema": dataset.SCHEMA, "images": images, "shards": shards}
    (out / dataset.MANIFEST).write_text(json.dumps(manifest))


def main() -> None:
    """Make both sets where they are not there yet, evaluate, read the result back, and print what it took."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--images", type=int, default=IMAGES)
    parser.add_argument("--seed", type=int, default=81)
    asked = parser.parse_args()
    made, truth, guess = (asked.folder / name for name in ("made", "truth", "predicted"))
    if not made.exists():
        options = ["--preset", "recumbent", "--count", SHARD, "--seed", asked.seed, "--workers", 1]
        command = ["synth", "generate", *map(str, options), "--out", str(made)]
        asked.folder.mkdir(parents=True, exist_ok=True)
        run("synth generate", SHARD, command, asked.folder / "log")
    frames = [small(frame) for frame in Dataset.open(made)]
    for path, shown in ((truth, frames), (guess, [predicted(frame) for frame in frames])):
        if not path.exists():
            long_set(shown, path, asked.images)
    result = asked.folder / "result.npz"
    calls = {
        "evaluate": ["evaluate", str(guess), str(truth), "--out", str(result), "--overwrite", "--json"],
        "report": ["report", str(result), "--out", str(asked.folder / "report.html"), "--overwrite"],
    }
    for verb, call in calls.items():
        cost = run("command", asked.images, call, asked.folder / f"{verb}.json")
        print(f"{verb}: {cost.cpu_s:.0f} s of processor time, {cost.own_mb:.0f} MB", file=sys.stderr)
    print(f"result: {result.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()

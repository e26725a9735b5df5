"""What a load is measured on: little that was really made, made long by repeating it under new ids."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from annotate.labelset import dataset
from annotate.labelset.dataset import ORDER, Dataset
from annotate.labelset.label_set import FRAMES, MANIFEST, LabelSet
from sensors.rig.frame import FRAME_PERIOD_NS
from sensors.rig.rig_calibration import calibration_to_json
from sensors.session.reader import Session
from sensors.session.writer import SessionWriter

SHARD = 256
"""Images of a shard that `synth generate` writes."""
LAST = 2
"""Shards that a long run really makes."""


def long_session(short: Path, out: Path, frames: int) -> None:
    """A session that shows the frames of another again and again, with time going on."""
    source = Session(short)
    shown = list(source)
    with SessionWriter(out, source.calibration, source.name) as writer:
        for index in range(frames):
            frame = shown[index % len(shown)]
            writer.write(replace(frame, index=index, stamp_ns=index * 15 * FRAME_PERIOD_NS))


def long_labels(short: Path, out: Path, frames: range, name: Callable[[int], str]) -> None:
    """These frames of a label set that holds those of another again and again, as links to its files."""
    ids = LabelSet.open(short).frame_ids
    files = {i: sorted((short / FRAMES).glob(f"{i}.*")) for i in ids}
    (out / FRAMES).mkdir(parents=True)
    shutil.copy(short / MANIFEST, out / MANIFEST)
    for index in frames:
        for file in files[ids[index % len(ids)]]:
            (out / FRAMES / f"{name(index)}{file.name[file.name.index('.') :]}").hardlink_to(file)


def long_dataset(short: Path, out: Path, images: int) -> None:
    """The shards of a dataset again and again, the images under new ids: all but the last ones, and without
    a manifest, as a `synth generate` of so many that broke off."""
    source = Dataset.open(short)
    shards = [(short / name).read_bytes() for name, _ in source.shards]
    out.mkdir()
    for shard in range(-(-images // SHARD) - LAST):
        data = renamed(shards[shard % len(shards)], shard * SHARD)
        (out / f"shard-{shard:06d}.tar").write_bytes(data)
    order = json.loads((short / ORDER).read_bytes()) | {"images": images}
    (out / ORDER).write_text(json.dumps(order, sort_keys=True) + "\n")


def renamed(shard: bytes, first: int) -> bytes:
    """A shard whose images are numbered from ``first`` on: names and checksums of tar's headers changed."""
    data, at, member = bytearray(shard), 0, 0
    while data[at]:
        old, new = bytes(data[at : at + 8]), f"{first + member // 3:08d}".encode()
        told = int(data[at + 148 : at + 154], 8) + sum(new) - sum(old)
        data[at : at + 8], data[at + 148 : at + 154] = new, f"{told:06o}".encode()
        at += 512 + -(-int(data[at + 124 : at + 135], 8) // 512) * 512
        member += 1
    return bytes(data)


def last_shards(whole: Path, out: Path) -> None:
    """A dataset of the last shards of another one."""
    manifest = json.loads((whole / dataset.MANIFEST).read_bytes())
    left = manifest["images"] - (len(manifest["shards"]) - LAST) * SHARD
    out.mkdir()
    for shard in manifest["shards"][-LAST:]:
        (out / shard["file"]).hardlink_to(whole / shard["file"])
    last = manifest | {"shards": manifest["shards"][-LAST:], "images": left}
    (out / dataset.MANIFEST).write_text(json.dumps(last))


def broken_off(made: Path, out: Path, frames: range, source: Path, name: Callable[[int], str]) -> None:
    """The label set of a run over ``source`` that broke off: these frames are there, as links to ``made``'s.

    What a run compares when it goes on (source, calibration, hashes) is told as this source has it.
    """
    long_labels(made, out, frames, name)
    info = json.loads((out / MANIFEST).read_bytes())
    if source.is_dir():
        info["steps"]["predict"]["dataset"] = dataset.sha256(source / dataset.MANIFEST)
        info["source"] = source.resolve().name
    else:
        session = Session(source)
        info["source"], info["sha256"] = session.name, session.sha256
        info["calibration"] = calibration_to_json(session.calibration)
    (out / MANIFEST).write_text(json.dumps(info, indent=1, sort_keys=True) + "\n")

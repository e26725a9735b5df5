"""Recordings of real people, cut short."""

import json
import shutil
from pathlib import Path


def first_frames(take: Path, folder: Path, count: int = 12) -> Path:
    """Copy the first frames of a take of real people below ``folder``; return the copy."""
    short = folder / "takes" / take.name
    (short / "depth").mkdir(parents=True)
    joints = json.loads((take / "joints.json").read_text())
    kept = sorted(joints)[:count]
    for name in kept:
        shutil.copy(take / "depth" / f"{name}.png", short / "depth")
    (short / "joints.json").write_text(json.dumps({name: joints[name] for name in kept}))
    shutil.copy(take / "intrinsics.json", short)
    return short

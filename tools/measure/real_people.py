"""The network on real people with tracked joints: ``python -m tools.measure.real_people [WEIGHTS]``.

Needs ../shared/data/real_people. Prints hit joints, facing and posture of the single frames and each take. A
tracker's joints are not true joints: they are a few centimetres off, and most trackers assume a person who
faces the camera.
"""

import json
import runpy
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from annotate.labelset.label_set import LabelSet
from eval.network.body_state import BodyState
from eval.network.onnx_network import SHIPPED_WEIGHTS, OnnxNetwork
from eval.network.predict_source import predict_source
from sensors.importers.open_source import open_source
from synth.body.skeleton import JOINT_ID
from synth.images.standing_statistics import facing_deg

PEOPLE = Path(__file__).resolve().parents[3] / "shared" / "data" / "real_people"
TRACKED = {"neck": 1, "pelvis": 3, "left_shoulder": 4, "right_shoulder": 8, "left_hip": 12, "right_hip": 16}
"""Index in ``joints.json`` of the joints that give a facing."""
NEAR_DEG = 30.0
NEAR_PX = 3.0  # a tracker's joint on the other side is tolerated so near to its own side


def tracked_facing_deg(joints: dict[str, list], camera: dict[str, float]) -> float:
    """Return the facing by a tracker's joints of one frame: pixels ``uv`` and depths ``z_mm``."""
    (u, v), z = np.array(joints["uv"], float).T, np.array(joints["z_mm"], float)
    mm = np.column_stack([(u - camera["cx"]) / camera["fx"] * z, (v - camera["cy"]) / camera["fy"] * z, z])
    placed = np.full((len(JOINT_ID), 3), np.nan)
    for name, index in TRACKED.items():
        placed[JOINT_ID[name]] = mm[index]
    return facing_deg(placed)


@dataclass(frozen=True)
class People:
    """Scores of a network on a folder of real people.

    scored: by the recordings' own score.py. far_swaps: share of the joints on the other side and more than
    ``NEAR_PX`` from their own. off_deg: error of the facing by frame; 180 without a facing. postures: counts.
    """

    scored: dict[str, float]
    far_swaps: float
    off_deg: np.ndarray
    postures: Counter[str]


def measure_people(folder: Path, network: OnnxNetwork) -> People:
    """Measure a network on a folder of real people."""
    joints = json.loads((folder / "joints.json").read_text())
    camera = json.loads((folder / "intrinsics.json").read_text())
    with tempfile.TemporaryDirectory() as out:
        labels = predict_source(open_source(folder), network, Path(out) / "p", lambda n: None).labels
        command = [sys.executable, PEOPLE / "score.py", labels.path, folder]
        scored = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
        far = far_swaps(labels, joints) / scored["joints"]
        notes = [labels.notes(frame_id).get("bearing") for frame_id in labels.frame_ids]
    off, postures = [], Counter()
    for name, note in zip(sorted(joints), notes, strict=True):
        bearing = BodyState.from_note(note)
        turned = 180.0 if bearing is None else bearing.facing_deg - tracked_facing_deg(joints[name], camera)
        off.append(abs((turned + 180) % 360 - 180))
        postures["none" if bearing is None else bearing.name] += 1
    return People(scored, far, np.array(off), postures)


def far_swaps(labels: LabelSet, joints: dict) -> int:
    """Count score.py's joints on the other side that are not near a pixel of their own side."""
    score = runpy.run_path(str(PEOPLE / "score.py"))
    right, twin = score["RIGHT"], np.array(score["TWIN"])
    count = 0
    for frame, seen in zip(labels, (joints[name] for name in sorted(joints)), strict=True):
        for (u, v), z, own in zip(np.rint(seen["uv"]).astype(int), seen["z_mm"], right, strict=True):
            height, width = frame.parts.shape
            if not (1 <= u < width - 1 and 1 <= v < height - 1):
                continue
            if frame.depth_mm[v, u] == 0 or not -60 < z - int(frame.depth_mm[v, u]) < 220:
                continue
            part = int(np.bincount(frame.parts[v - 1 : v + 2, u - 1 : u + 2].ravel()).argmax())
            rows, columns = np.nonzero(np.isin(frame.parts, list(own)))
            swapped = part < len(twin) and part not in own and twin[part] in own
            count += swapped and not (np.hypot(rows - v, columns - u) <= NEAR_PX).any()
    return count


def folders() -> list[Path]:
    """Return the folders of the takes and of the single frames."""
    return [*sorted((PEOPLE / "takes").iterdir()), PEOPLE / "frames"]


def print_people(name: str, found: People) -> None:
    """Print a line."""
    scored, off = found.scored, found.off_deg
    near = np.mean(off <= NEAR_DEG)
    print(
        f"{name}: hits {scored['mean_hit_rate']:.3f}, swaps {scored['swap_rate']:.3f}, by more than "
        f"{NEAR_PX:.0f} px {found.far_swaps:.4f}, missing {scored['missing']}; facing to {NEAR_DEG:.0f} "
        f"degrees {near:.3f} of {len(off)}, median {np.median(off):.0f}, 90 % {np.quantile(off, 0.9):.0f}; "
        f"{dict(found.postures)}",
        flush=True,
    )


def main(weights: Path) -> None:
    network = OnnxNetwork(weights)
    for folder in folders():
        print_people(folder.name, measure_people(folder, network))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else SHIPPED_WEIGHTS)

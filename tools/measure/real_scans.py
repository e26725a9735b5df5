"""Joints on the real scans of a standing person, beside those that the Kinect's own software gave.

python -m tools.measure.real_scans [WEIGHTS]; needs ../shared/data. Microsoft's joints are no truth: they are
a few centimetres off themselves, its hips sit high, and it takes every person to face the camera.
"""

import csv
import re
import sys
import tempfile
from pathlib import Path

import numpy as np

from eval.network.onnx_network import SHIPPED_WEIGHTS, OnnxNetwork
from eval.network.predict import predict_source
from eval.scores.joints import JOINT, JOINT_NAMES, joint_evidence
from eval.scores.skeleton_fit import fit_skeletons
from sensors.importers.open_source import open_source

SCANS = Path(__file__).resolve().parents[3] / "shared" / "data" / "kinect2_standing"
MICROSOFTS = {"head": "head", "neck": "neck", "pelvis": "spinebase"}


def microsofts_mm(path, note):
    """The Kinect's joints (15, 3) in the camera frame of the imported scan; note: how that was moved."""
    with path.open(newline="") as file:
        rows = {row[0].lower(): row[1:4] for row in csv.reader(file) if row[0] not in ("Joints", "Degree")}
    moved = re.search(r"moved by \((.*)\) m", note)
    shift = np.array(moved[1].split(","), float) if moved else np.zeros(3)
    names = [MICROSOFTS.get(name, "".join(reversed(name.split("_")))) for name in JOINT_NAMES]
    given = [rows[name] for name in names]
    return (np.array(given, float) * (1, -1, -1) + shift) * 1000


def main(weights):
    """Print every joint's distance, scan by scan."""
    network = OnnxNetwork(weights)
    for path in sorted(SCANS.glob("*.pcd")):
        source = open_source(path)
        with tempfile.TemporaryDirectory() as folder:
            labels = predict_source(source, network, Path(folder) / "p", lambda n: None).labels
            frame = labels.read("000000")
            seen = joint_evidence(frame.parts, frame.depth_mm, labels.intrinsics)
        joints = fit_skeletons(seen[None], [""])[0]
        off = np.linalg.norm(joints - microsofts_mm(path.with_suffix(".csv"), source.notes[0]), axis=1)
        told = ", ".join(f"{name} {off[JOINT[name]]:.0f}" for name in JOINT_NAMES)
        print(f"{path.stem}: mean {np.nanmean(off):.0f} mm; {told}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else SHIPPED_WEIGHTS)

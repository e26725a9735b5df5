"""Small label sets of recordings: by colour, by a suit, by a network."""

from pathlib import Path

import numpy as np

from annotate.correction.correction import Correction
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.parts import UNDEFINED
from annotate.posture import POSTURES
from eval.network.body_state import BodyState
from eval.scores.joints import JOINT, N_JOINTS
from sensors.rig.camera import Intrinsics

CAMERA = Intrinsics(64, 48, 60, 60, 24, 24)
COLOUR, BY_SUIT, BY_NETWORK = ({"steps": {name: {}}} for name in ("label_by_colour", "label", "predict"))


def joints_px(n: int) -> np.ndarray:
    """Joints of a person who faces the camera: head up, own left on the image's right."""
    at = np.full((N_JOINTS, 3), 1500.0)
    for name, number in JOINT.items():
        side = 4 if "left" in name else -4 if "right" in name else 0
        row = {"head": 10, "neck": 15, "shoulder": 16, "elbow": 20, "wrist": 24}.get(name.split("_")[-1], 28)
        at[number, :2] = 24 + n + side, row
    return at


def witnessed(n: int) -> dict:
    """Joints by a witness: the left wrist is hidden, the head is displaced by 5 cm."""
    state = BodyState(0.0, 1.0, np.eye(1, len(POSTURES))[0], joints_px(n))
    joints = dict(zip(JOINT, state.joints_mm(CAMERA), strict=True))
    joints["head"] = joints["head"] + np.array([50.0, 0, 0])
    return {name: at.tolist() for name, at in joints.items() if name != "left_wrist"}


def frame(n: int, sure: float = 0.75) -> FrameLabels:
    """A head over a torso, another person's pixels beside; frames differ in their place."""
    parts, persons = np.zeros((48, 64), np.uint8), np.zeros((48, 64), np.uint8)
    parts[6:14, 20 + n : 28 + n], parts[14:40, 16 + n : 32 + n] = 1, 2
    persons[parts > 0] = 1
    persons[6:40, 50:60], parts[6:40, 50:60] = 2, UNDEFINED
    depth = np.where(persons > 0, np.uint16(1500), np.uint16(0))
    note = {
        "facing_deg": 0.0,
        "facing_sure": 1.0,
        "postures": [0, 1, 0, 0, 0, 0],
        "joints_px": joints_px(n).tolist(),
        "witness": {"joints_mm": witnessed(n), "outlines": []},
    }
    confidence = np.full(parts.shape, sure, np.float32)
    return FrameLabels(f"{n:06d}", depth, parts, confidence, notes={"bearing": note}, persons=persons)


def written(path: Path, info: dict, count: int = 3) -> Path:
    labels = LabelSet.create(path, CAMERA, {"source": "test", **info})
    for n in range(count):
        labels.write(frame(n))
    return path


def judged(path: Path, frame_id: str, verdict: str) -> None:
    with Correction.open(path, "ann") as correction:
        correction.edit(frame_id).judge(verdict, "blurred")

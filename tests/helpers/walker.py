"""Person who walks, lies, or stands and moves the arms: joints in the world, and BVH of many dialects."""

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

PARENT = {
    "Hips": "", "Spine": "Hips", "Chest": "Spine", "Neck": "Chest", "Head": "Neck", "Top": "Head",
    "LeftShoulder": "Chest", "LeftArm": "LeftShoulder", "LeftForeArm": "LeftArm", "LeftHand": "LeftForeArm",
    "RightShoulder": "Chest", "RightArm": "RightShoulder", "RightForeArm": "RightArm",
    "RightHand": "RightForeArm",
    "LeftUpLeg": "Hips", "LeftLeg": "LeftUpLeg", "LeftFoot": "LeftLeg", "LeftToeBase": "LeftFoot",
    "RightUpLeg": "Hips", "RightLeg": "RightUpLeg", "RightFoot": "RightLeg", "RightToeBase": "RightFoot",
}  # fmt: skip
"""Joints and their parents; "Top" is the end of the head."""
JOINTS = tuple(PARENT)
OFFSET = {
    "Hips": (0, 0, 0), "Spine": (0, 10, 0), "Chest": (0, 18, 0), "Neck": (0, 22, 0), "Head": (0, 9, 1),
    "Top": (0, 17, 0),
    "LeftShoulder": (4, 17, 0), "LeftArm": (14, 0, 0), "LeftForeArm": (0, -28, 0), "LeftHand": (0, -25, 0),
    "LeftUpLeg": (9, -2, 0), "LeftLeg": (0, -41, 0), "LeftFoot": (0, -41, 0), "LeftToeBase": (0, -8, 10),
}  # fmt: skip
OFFSET |= {
    name.replace("Left", "Right"): (-x, y, z) for name, (x, y, z) in OFFSET.items() if name.startswith("Left")
}
"""Centimetres from the parent: x to the person's left, y up, z ahead."""
FRAMES = 24
STEP_CM = 7.0
"""Way a frame: 1.6 m in all."""


def _local(doing: str) -> dict[str, Rotation]:
    """Rotations (F) of joints about their parents."""
    swing = np.sin(np.arange(FRAMES) / 3)
    turns = {name: np.zeros((FRAMES, 3)) for name in JOINTS}
    for side, sign in (("Left", 1), ("Right", -1)):
        turns[f"{side}Arm"][:, 0] = 25 * sign * swing
        turns[f"{side}ForeArm"][:, 0] = -30
        if doing == "walks":
            turns[f"{side}UpLeg"][:, 0] = -25 * sign * swing
            turns[f"{side}Leg"][:, 0] = 20 + 15 * sign * swing
        if doing == "lies":
            turns[f"{side}Foot"][:, 0] = 35
            turns[f"{side}UpLeg"][:, 0] = -10 - 10 * sign * swing
    return {name: Rotation.from_euler("XYZ", angles, degrees=True) for name, angles in turns.items()}


def _pose(doing: str) -> tuple[np.ndarray, Rotation, dict[str, Rotation]]:
    """Places (F, 3) and rotations of the hips in centimetres with y up, and rotations about parents."""
    time = np.arange(FRAMES)
    hips = np.stack([0 * time, 93 + np.cos(time), STEP_CM * time - 80], axis=1)
    upright = Rotation.identity(FRAMES)
    if doing == "stands":
        hips = np.tile([0.0, 92.0, 3.0], (FRAMES, 1))
    if doing == "lies":
        hips = np.tile([20.0, 11.0, -30.0], (FRAMES, 1))
        upright = Rotation.from_euler("XYZ", np.tile([-90.0, 0, 0], (FRAMES, 1)), degrees=True)
    return hips, upright, _local(doing)


def places_cm(doing: str = "walks") -> np.ndarray:
    """Places (F, J, 3) of the joints, y up."""
    hips, upright, local = _pose(doing)
    at, turned = {"Hips": hips}, {"Hips": upright * local["Hips"]}
    for name in JOINTS[1:]:
        parent = PARENT[name]
        at[name] = at[parent] + turned[parent].apply(OFFSET[name])
        turned[name] = turned[parent] * local[name]
    return np.stack([at[name] for name in JOINTS], axis=1)


def bvh_of(
    doing: str = "walks",
    names: Callable[[str], str] = str,
    positions: str = "root",
    zero_pose: Rotation | None = None,
    world: Rotation | None = None,
) -> str:
    """A BVH of ``places_cm``.

    names: of the joints. positions: which joints have position channels: "root"; "replace", all, by places in
    the parent's frame; "add", all, by displacements; "some", as Blender writes them; "zero", all, always 0.
    zero_pose: turns the pose of all rotations 0. world: turns the axes of the file.
    """
    zero = zero_pose or Rotation.identity()
    world = world or Rotation.identity()
    hips, upright, local = _pose(doing)
    columns: list[np.ndarray] = []

    def node(name: str) -> str:
        offset = zero.apply(OFFSET[name]).round(6)
        if name == "Top":
            return f"End Site\n{{\nOFFSET {offset[0]:g} {offset[1]:g} {offset[2]:g}\n}}\n"
        some = positions == "some" and name in ("Spine", "LeftUpLeg", "RightUpLeg", "Neck", "LeftShoulder")
        placed = name == "Hips" or positions in ("replace", "add", "zero") or some
        if placed:
            own = world.apply(hips) if name == "Hips" else np.tile(offset, (FRAMES, 1))
            columns.append(0 * own if name != "Hips" and positions in ("add", "zero") else own)
            if name != "Hips" and positions == "add":
                columns[-1] = columns[-1] + [0.05, 0.0, 0.0]
        turn = (
            world * upright * local[name] * zero.inv() if name == "Hips" else zero * local[name] * zero.inv()
        )
        columns.append(turn.as_euler("ZXY", degrees=True, suppress_warnings=True))
        kind = "6 Xposition Yposition Zposition" if placed else "3"
        head = f"{'ROOT' if name == 'Hips' else 'JOINT'} {names(name)}\n{{\nOFFSET %g %g %g\n" % tuple(offset)
        below = "".join(node(child) for child in JOINTS if PARENT[child] == name)
        tail = below or "End Site\n{\nOFFSET 0 0 0\n}\n"
        return f"{head}CHANNELS {kind} Zrotation Xrotation Yrotation\n{tail}}}\n"

    text = "HIERARCHY\n" + node("Hips")
    rows = [" ".join(f"{v:.6f}" for v in row) for row in np.concatenate(columns, axis=1)]
    return text + f"MOTION\nFrames: {FRAMES}\nFrame Time: 0.033333\n" + "\n".join(rows) + "\n"

"""A doll of capsules, labelled well and badly, and a report of it in which every name is hostile."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction.audit import Audit, PersonWork, WorkedFrame
from annotate.frame_labels import FrameLabels
from annotate.labelset.images import encode_parts, encode_png
from annotate.labelset.label_set import LabelSet
from annotate.parts import UNDEFINED, swap_left_right
from eval.compare.compare import Comparison
from eval.compare.results import Result
from eval.report.gather import Clouds, Material, pictures_of, shown_set
from eval.report.training_history import load_training
from sensors.rig.camera import Intrinsics

CAMERA = Intrinsics(width=96, height=80, fx=90.0, fy=90.0, cx=47.5, cy=39.5)
HOSTILE = """</script><script>window.hit=1</script><img src=x onerror="window.hit=1">"'&\u202e"""
"""Name from a label file: markup, quotes, the end of a script, reversed text."""
LIMBS = {  # part id: ends of a capsule in units of the picture's height, and its radius
    1: ((0.60, 0.14), (0.60, 0.20), 0.075),
    2: ((0.60, 0.30), (0.60, 0.46), 0.12),
    3: ((0.75, 0.30), (0.80, 0.46), 0.045),
    4: ((0.45, 0.30), (0.40, 0.46), 0.045),
    5: ((0.80, 0.50), (0.74, 0.62), 0.040),
    6: ((0.40, 0.50), (0.46, 0.62), 0.040),
    7: ((0.55, 0.58), (0.65, 0.58), 0.085),
    8: ((0.67, 0.64), (0.72, 0.74), 0.060),
    9: ((0.53, 0.64), (0.48, 0.74), 0.060),
    10: ((0.73, 0.80), (0.73, 0.93), 0.045),
    11: ((0.47, 0.80), (0.47, 0.93), 0.045),
}


def person(seed: int, camera: Intrinsics = CAMERA) -> FrameLabels:
    """A seated doll of capsules 1.5 m away, posed by the seed, before a wall at 2.4 m."""
    rng = np.random.default_rng(seed)
    height = camera.height
    parts = np.zeros((camera.height, camera.width), np.uint8)
    for part, (start, end, radius) in LIMBS.items():
        ends = (np.array([start, end]) + rng.normal(0, 0.01, 2)) * height
        a, b = (tuple(round(c) for c in p) for p in ends)
        cv2.line(parts, a, b, part, thickness=int(2 * radius * height))
    inside = cv2.distanceTransform((parts > 0).astype(np.uint8), cv2.DIST_L2, 5)
    depth = np.where(parts > 0, 1500 - 12 * inside * 80 / height, 2400 + rng.normal(0, 4, parts.shape))
    parts[: height // 20] = UNDEFINED
    return FrameLabels(f"{seed:06d}", depth.astype(np.uint16), parts, status="truth", subject=f"s{seed % 3}")


def guessed(truth: FrameLabels, seed: int, shift: int = 1) -> FrameLabels:
    """A prediction that is shifted, holed, now and then swaps sides, and is unsure where it is wrong."""
    rng = np.random.default_rng(seed + 99)
    parts = np.roll(truth.parts, shift, axis=1)
    if rng.random() < 0.15:
        parts = swap_left_right(parts)
    v, u = rng.integers(0, 60, 2)
    parts[v : v + 9, u : u + 9] = rng.choice([0, 2, 7, UNDEFINED])
    sure = np.where(parts == truth.parts, 0.9, 0.6).astype(np.float32)
    return replace(truth, parts=parts, status="auto", confidence=sure)


def cloud(truth: FrameLabels, camera: Intrinsics = CAMERA) -> ThermalCloud:
    """The doll's cloud: skin at 33 degrees, the wall at 22, some of it unseen by the thermal camera."""
    v, u = np.mgrid[: camera.height, : camera.width]
    z = truth.depth_mm.astype(np.float32) / 1000
    points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], -1)
    warm = np.where((truth.parts > 0) & (truth.parts != UNDEFINED), 33, 22).astype(np.float32)
    warm[:, :8] = np.nan
    gray = np.zeros((*z.shape, 3), np.uint8)
    return ThermalCloud(camera, truth.depth_mm, points.astype(np.float32), gray, z > 0, warm)


def label_sets(folder: Path, frames: int = 6) -> tuple[LabelSet, LabelSet]:
    """A prediction and its truth on disk."""
    truth = LabelSet.create(folder / "truth", CAMERA, {})
    predicted = LabelSet.create(folder / "predicted", CAMERA, {})
    for seed in range(frames):
        truth.write(person(seed))
        predicted.write(guessed(person(seed), seed))
    return predicted, truth


def trained(folder: Path) -> Path:
    """A folder as `train` leaves it, after twelve epochs."""
    (folder / "frame").mkdir(parents=True)
    score = {"mean_recall": 0.8, "miou": None}
    history = {
        "plan": {"network": {"kind": HOSTILE}, "epochs": 12},
        "images": 100,
        "points": [{"images": 50 * i, "loss": 2.0 / (i + 1)} for i in range(24)],
        "epochs": [{"number": i, "loss": 1 / i, "seconds": 2.0, **score} for i in range(1, 13)],
    }
    (folder / "history.json").write_text(json.dumps(history))
    frame = person(0)
    (folder / "frame" / "depth.png").write_bytes(encode_png(frame.depth_mm))
    (folder / "frame" / "truth.parts.png").write_bytes(encode_parts(frame.parts))
    for epoch in range(13):
        (folder / "frame" / f"epoch-{epoch:03d}.parts.png").write_bytes(encode_parts(frame.parts))
    return folder


def hostile_material(sets: tuple[LabelSet, LabelSet], compared: Comparison, run: Path) -> Material:
    """Every section filled, and every text that comes from outside hostile."""
    hostile = replace(
        compared,
        frame_ids=(HOSTILE, *compared.frame_ids[1:]),
        subjects=(*compared.subjects[1:], HOSTILE),
        traits=tuple(replace(traits, hard=(HOSTILE,), activity=HOSTILE) for traits in compared.traits),
        joints_mm=np.random.default_rng(0).uniform(5, 200, (6, 15)),
    )
    lying = {"predicted": str(sets[0].path), "truth": str(sets[1].path)}
    frames, scenes = pictures_of(Result("Automatic", compared, lying), Clouds([]), each=2)
    frames = [replace(frame, frame_id=HOSTILE, group=HOSTILE, subject=HOSTILE) for frame in frames]
    work = PersonWork(
        HOSTILE, "2026-01-02T10:00:00Z", "2026-01-03T10:00:00Z", 6, 5, 0.2, 7.0, 30.0, {}, 40, 3, {}, 0.04, {}
    )
    course = tuple(WorkedFrame(HOSTILE, 10.0 - n, "0001" * (n > 2)) for n in range(6))
    shown = shown_set(sets[0], HOSTILE, Clouds([]))
    return Material(
        results=(
            Result("Automatic", compared, lying),
            Result(f"Network {HOSTILE}", hostile, {HOSTILE: HOSTILE}),
        ),
        ceiling=Result("Two people", compared),
        galleries={f"Network {HOSTILE}": frames},
        scenes=[replace(scene, title=HOSTILE) for scene in scenes],
        trainings=[replace(load_training(run), title=HOSTILE)],
        audits={HOSTILE: Audit((work,), {"000001": HOSTILE}, course)},
        shown=[replace(shown, title=HOSTILE)],
        facts={"seed": "1", HOSTILE: HOSTILE},
    )

"""Frames of the virtual rig to train the shipped reader on: any suit, seat, difficulty and cameras."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.suit.palette import DEFAULT_SUIT
from eval.training.segmentation.examples import ROUGH_EVERY, Example, example_of
from sensors.recording.rig_templates import REFERENCE
from synth.appearance.random_suit import random_suit
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import RigOptions, VirtualRig

SUBJECTS, FRAMES = 8, 32
"""People and frames of one recording. Chosen by eye."""
FIRST_SEED, FIRST_SUIT = 8_800_000, 880_000
"""Seeds of the first recording and of its suit: used for nothing else."""
HARD, OTHER_SUIT, FULL_COLOR = 0.6, 0.7, 0.05
"""Shares of `hard` recordings, of those in another suit than the default one, and of those that are no
drafts. Chosen by eye."""
PLACES = {"sofa": 0.2, "chair": 0.15, "bed": 0.35, "floor": 0.3}
"""Shares of the scenes: who lies in bed or on the floor is the hardest to read and to find. Chosen by eye."""
OTHER_RIGS, OTHER_RIG = ("d455-lepton", "bolt-lepton", "azure-boson"), 0.18
"""Rigs beside the reference, and the share of recordings by one of them. Chosen by eye."""
CLOSED = 0.08
"""Share of frames whose thermal camera sees nothing, its flag being closed. Chosen by eye."""


def training_rig(number: int) -> VirtualRig:
    """The rig of a recording, the same for the same number from 0."""
    rng = np.random.default_rng((88001, number))
    difficulty = "hard" if rng.random() < HARD else "normal"
    scene = str(rng.choice(list(PLACES), p=list(PLACES.values())))
    rig = str(rng.choice(OTHER_RIGS)) if rng.random() < OTHER_RIG else REFERENCE
    suit = random_suit(FIRST_SUIT + number) if rng.random() < OTHER_SUIT else DEFAULT_SUIT
    draft, seed = bool(rng.random() >= FULL_COLOR), FIRST_SEED + number
    return VirtualRig(FRAMES, SUBJECTS, difficulty, seed, RigOptions(scene, rig=rig, suit=suit, draft=draft))


def rig_examples(rig: VirtualRig) -> Iterator[Example]:
    """Examples of a rig's frames, in memory: nothing is encoded.

    The labels before are the true ones of the frame before; of each second person's first frame those of
    the person before, as in a recording that names nobody.
    """
    fuser, rng = Fuser(rig.calibration), np.random.default_rng((88002, rig.seed))
    before: FrameLabels | None = None
    for frame, known in rig.with_truth():
        truth = truth_labels(frame, known, rig.calibration.depth)
        if before is not None and before.subject != truth.subject and rng.random() < 0.5:
            before = None
        cloud = fuser.fuse_frame(frame)
        if rng.random() < CLOSED:
            cloud = _unfelt(cloud)
        example = example_of(cloud, truth, before, rig.suit, rough=frame.index % ROUGH_EVERY == 0)
        if example is not None:
            yield example
        before = truth


def _unfelt(cloud: ThermalCloud) -> ThermalCloud:
    """The cloud as behind a closed flag."""
    return replace(cloud, temperature_c=np.full_like(cloud.temperature_c, np.nan))

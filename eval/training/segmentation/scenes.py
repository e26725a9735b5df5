"""Frames of the virtual rig for training the shipped suit network: suits, furniture, difficulty and cameras
vary at random.

Constants are untuned.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.frame_labels import FrameLabels
from annotate.suit.palette import DEFAULT_SUIT
from eval.training.segmentation.examples import ROUGH_EVERY, Example, example_of
from eval.training.shared_bodies import HELD_OUT
from sensors.recording.rig_templates import REFERENCE
from synth.appearance.random_suit import random_suit
from synth.body.body import Body
from synth.body.crowd import suit_wearers
from synth.cameras.random_sensor import draw_sensor
from synth.data_files import TRAINING
from synth.own_camera import OwnCamera
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import RigOptions, VirtualRig

SUBJECTS, FRAMES = 8, 32  # of one recording
FIRST_SEED, FIRST_SUIT = 8_800_000, 880_000  # of the first recording; used for nothing else
OTHER_SUIT, FULL_COLOR = 0.7, 0.05  # shares of recordings in a random suit, and at full colour resolution
PLACES = {"sofa": 0.2, "chair": 0.15, "bed": 0.35, "floor": 0.3}  # shares; lying people are the hardest
WITH_THINGS = 4000  # first recording in whose rooms warm things and bare arm rests are common
ROOMS_WITH_THINGS = {
    "sofa": 0.2,
    "chair": 0.05,
    "armchair": 0.15,
    "wheelchair": 0.05,
    "bed": 0.3,
    "floor": 0.25,
}
WARM_THINGS = 0.5  # share of their subjects beside whom one lies
OTHER_RIGS = ("d455-lepton", "bolt-lepton", "azure-boson")
CLOSED = 0.08  # share of frames behind a closed thermal flag
FILTERED = "recorded_stereo"  # kind of depth camera whose filters smooth depth
FILTERED_SHARE = 0.4  # share of recordings by such a camera


def draw_scene(
    rng: np.random.Generator, hard: float, places: Mapping[str, float], other_rig: float
) -> tuple[str, str, str]:
    """Draw the names of a difficulty, a scene and a rig.

    hard: share of recordings with difficulty ``hard``. places: scenes with their shares. other_rig: share of
    recordings with another rig.
    """
    difficulty = "hard" if rng.random() < hard else "normal"
    scene = str(rng.choice(list(places), p=list(places.values())))
    return difficulty, scene, str(rng.choice(OTHER_RIGS)) if rng.random() < other_rig else REFERENCE


def draw_filtered(rng: np.random.Generator) -> OwnCamera | None:
    """Draw the depth camera of a recording: one with filters that smooth depth, or None for the rig's own."""
    stereo = draw_sensor(rng, FILTERED)
    return OwnCamera(stereo.camera, FILTERED) if rng.random() < FILTERED_SHARE else None


def wearers(held_out: bool) -> tuple[Body, ...]:
    """Return the bodies of recordings to train on, or the bodies of held-out recordings."""
    return tuple(body for body in suit_wearers(TRAINING) if (body.name in HELD_OUT) == held_out)


def training_rig(number: int, held_out: bool = False) -> VirtualRig:
    """Return the rig of training recording ``number`` (from 0), always the same for one number.

    held_out: its people have the bodies that are not trained on.
    """
    rng = np.random.default_rng((88001, number))
    with_things = number >= WITH_THINGS
    places = ROOMS_WITH_THINGS if with_things else PLACES
    difficulty, scene, rig = draw_scene(rng, 0.6, places, 0.18)
    suit = random_suit(FIRST_SUIT + number) if rng.random() < OTHER_SUIT else DEFAULT_SUIT
    draft, seed = bool(rng.random() >= FULL_COLOR), FIRST_SEED + number
    camera = draw_filtered(rng)
    options = RigOptions(
        scene,
        rig=rig,
        suit=suit,
        draft=draft,
        wearers=wearers(held_out),
        camera=camera,
        warm_things=WARM_THINGS * with_things,
    )
    return VirtualRig(FRAMES, SUBJECTS, difficulty, seed, options)


def rig_examples(rig: VirtualRig) -> Iterator[Example]:
    """Yield examples of a rig's frames, in memory: images are not encoded.

    The input labels of the previous frame are the true ones. In half of the changes of person they are left
    out, as in recordings whose metadata name the person.
    """
    fuser, rng = Fuser(rig.calibration), np.random.default_rng((88002, rig.seed))
    before: FrameLabels | None = None
    for frame, known in rig.with_truth():
        truth = truth_labels(frame, known, rig.calibration.depth)
        if before is not None and before.subject != truth.subject and rng.random() < 0.5:
            before = None
        cloud = fuser.fuse_frame(frame)
        if rng.random() < CLOSED:
            cloud = replace(cloud, temperature_c=np.full_like(cloud.temperature_c, np.nan))
        example = example_of(cloud, truth, before, rig.suit, rough=frame.index % ROUGH_EVERY == 0)
        if example is not None:
            yield example
        before = truth

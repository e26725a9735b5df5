"""Labelling one frame of the virtual rig, beside the naive NumPy way."""

import statistics
import sys
import time

import numpy as np
from scipy import ndimage

from annotate.cloud.fuse import Fuser
from annotate.label_recording import SuitLabeller
from annotate.parts import N_CLASSES, PAPER, UNDEFINED
from annotate.segmentation.suit_network import shipped_suit_network
from annotate.suit.palette import chromaticity
from bench.fuse import fuse_naive
from eval.scores.confusion import confusion_matrix, mean_recall
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import VirtualRig

FRAMES = 8


def label_naive(calibration, suit, depth_mm, color_rgb, thermal_c):
    """Fuse with whole arrays, take the largest warm blob, give each point its nearest swatch."""
    cloud = fuse_naive(calibration, depth_mm, color_rgb, thermal_c)
    with np.errstate(invalid="ignore"):
        warm = (cloud.temperature_c > 25) & (cloud.temperature_c < 35)
    blobs, n = ndimage.label(warm, np.ones((3, 3)))
    person = blobs == 1 + np.argmax(ndimage.sum(warm, blobs, range(1, n + 1))) if n else warm
    gaps = np.square(chromaticity(cloud.color_rgb)[:, :, None] - chromaticity(suit.colors_rgb)).sum(-1)
    return np.where(person, suit.parts[gaps.argmin(-1)], 0).astype(np.uint8)


def bench():
    """Return rows of medians over frames: (name, seconds a frame, seconds of the naive way)."""
    rig = VirtualRig(FRAMES, 2, "normal", 77)
    fuser, labeller = Fuser(rig.calibration), SuitLabeller(rig.suit, shipped_suit_network())
    times = {"ours": [], "naive": []}
    scores = {"ours": np.zeros((N_CLASSES, N_CLASSES), int), "naive": np.zeros((N_CLASSES, N_CLASSES), int)}
    for frame, known in rig.with_truth():
        color, truth = frame.decode_color(), truth_labels(frame, known).parts
        start = time.perf_counter()
        cloud = fuser.fuse(frame.depth_mm, color, frame.thermal_c)
        parts = labeller.label(labeller.detect(cloud))[0].parts
        times["ours"].append(time.perf_counter() - start)
        start = time.perf_counter()
        naive = label_naive(rig.calibration, rig.suit, frame.depth_mm, color, frame.thermal_c)
        times["naive"].append(time.perf_counter() - start)
        scores["ours"] += confusion_matrix(truth, np.where(parts == UNDEFINED, 0, parts), PAPER)
        scores["naive"] += confusion_matrix(truth, naive, PAPER)
    # The first frame compiles or loads the kernels.
    ours, slow = (statistics.median(times[k][1:]) for k in ("ours", "naive"))
    ours_recall, naive_recall = (float(mean_recall(scores[k])) for k in ("ours", "naive"))
    print(f"label: mean recall {ours_recall:.3f}, naive {naive_recall:.3f}", file=sys.stderr)
    return [("label: fuse, person, parts", ours, slow)]

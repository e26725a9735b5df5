"""What a network loses by failing extractions: ``python -m tools.measure.network DATASET WEIGHTS.onnx...``.

Prints a Markdown table: mean recall and mIoU on the dataset's images as they are, and with a fifth of every
person's pixels removed in blobs (`occlude.cut`, again and again); the crop is fitted to what is left,
as it would be. Scored is what is left. The same pixels are removed for every network.
"""

import sys
from itertools import islice
from pathlib import Path

import numpy as np

from annotate.crop import crop_around, normalize
from annotate.frame_labels import FrameLabels
from annotate.labelset.labelled_frames import open_frames
from annotate.parts import BACKGROUND, N_CLASSES, UNDEFINED
from eval.network.onnx_network import OnnxNetwork
from eval.scores.confusion import confusion_matrix, mean_recall, miou
from synth.images.view import cut

REMOVED = 0.2
IMAGES = 1024
BATCH = 16
SEED = 2301


def incomplete(person: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A person's mask (h, w) without a fifth of its pixels: as near to that as whole blobs come."""
    whole, left = np.count_nonzero(person), person
    while np.count_nonzero(left) > (1 - REMOVED) * whole:
        before, left = left, cut(left, rng)
    return min(before, left, key=lambda mask: abs(np.count_nonzero(mask) - (1 - REMOVED) * whole))


def confusion(network: OnnxNetwork, frames: list[tuple[FrameLabels, np.ndarray]]) -> np.ndarray:
    """Confusion (12, 12) on frames, each with the pixels (h, w) that the extraction gives."""
    total = np.zeros((N_CLASSES, N_CLASSES), np.int64)
    for start in range(0, len(frames), BATCH):
        some = frames[start : start + BATCH]
        crops = [crop_around(mask) for _, mask in some]
        inputs = [
            normalize(crop.cut(f.depth_mm, 0), crop.cut(mask, False))
            for crop, (f, mask) in zip(crops, some, strict=True)
        ]
        for scores, crop, (frame, mask) in zip(
            network.probabilities(np.stack(inputs)), crops, some, strict=True
        ):
            parts = crop.paste((scores[1:].argmax(0) + 1).astype(np.uint8), mask.shape, BACKGROUND)
            truth = np.where(mask, frame.parts, np.uint8(UNDEFINED))
            total += confusion_matrix(truth, np.where(mask, parts, np.uint8(BACKGROUND)))
    return total


def main() -> None:
    """Measure and print."""
    every = open_frames(Path(sys.argv[1]))
    frames = list(islice(every, 0, None, max(1, len(every) // IMAGES)))
    whole = [(f, (f.parts > BACKGROUND) & (f.parts < UNDEFINED) & (f.depth_mm > 0)) for f in frames]
    rng = np.random.default_rng(SEED)
    holed = [(f, incomplete(mask, rng)) for f, mask in whole]
    share = 1 - sum(np.count_nonzero(m) for _, m in holed) / sum(np.count_nonzero(m) for _, m in whole)
    print(f"{len(frames)} images of {sys.argv[1]}; {share:.1%} of the person removed\n")
    print("| weights | mean recall | incomplete | lost | mIoU | incomplete |\n|---|---|---|---|---|---|")
    for path in map(Path, sys.argv[2:]):
        network = OnnxNetwork(path)
        a, b = confusion(network, whole), confusion(network, holed)
        row = (mean_recall(a), mean_recall(b), mean_recall(a) - mean_recall(b), miou(a), miou(b))
        print(f"| {path.parent.name} | " + " | ".join(f"{v:.4f}" for v in row) + " |", flush=True)


if __name__ == "__main__":
    main()

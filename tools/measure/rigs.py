"""Labelling and the network before each rig's cameras: ``python -m tools.measure.rigs FRAMES SEED RIG...``.

Half as many people as frames, on sofa, chair, bed and floor at ``normal``; the same people for every rig.
"""

import sys
import tempfile
from pathlib import Path

from annotate.label_recording import SuitLabeller, label_source
from annotate.labelset.label_set import LabelSet
from eval.compare.compare import Comparison, compare_sets
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict_source import predict_source
from sensors.session.reader import Session
from synth.rig.locations import SCENES
from synth.rig.simulate import simulate, truth_path
from synth.rig.virtual_rig import RigOptions, VirtualRig


def measured(rig: VirtualRig) -> tuple[Comparison, Comparison]:
    """Labels by the suit, and by the network, of what a rig records, against the truth."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "session.mcap"
        simulate(rig, path, lambda _: None)
        session, truth = Session(path), LabelSet.open(truth_path(path))
        suit = label_source(session, SuitLabeller(rig.suit), Path(folder) / "suit", lambda _: None).labels
        net = predict_source(session, OnnxNetwork(), Path(folder) / "net", lambda _: None).labels
        return compare_sets(suit, truth), compare_sets(net, truth)


def main(frames: int, seed: int, rigs: list[str]) -> None:
    """Prints three scores a scene and rig."""
    for scene in SCENES:
        for name in rigs:
            labelled, predicted = (
                found.scores
                for found in measured(
                    VirtualRig(frames, frames // 2, "normal", seed, RigOptions(scene, rig=name))
                )
            )
            print(
                f"{scene} {name}: person IoU {labelled['person_iou']:.4f}, recall with the suit "
                f"{labelled['mean_recall']:.4f}, of the network {predicted['mean_recall']:.4f}",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])

"""Scores of the network with and without refinement: ``python -m tools.measure.refinement``.

Prints mean recall, person IoU and swaps by scene and difficulty, with the thermal camera and without: 24
frames of eight people each, two seconds apart.
"""

import tempfile
from dataclasses import replace
from itertools import product
from pathlib import Path

from annotate.labelset.label_set import LabelSet
from eval.compare.compare import compare_sets
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict import PredictOptions
from eval.network.predict_source import predict_source
from eval.network.refine import shipped_refinement_network
from sensors.rig.frame import FrameSource, RigFrame
from sensors.session.reader import Session
from synth.rig.locations import SCENES
from synth.rig.simulate import simulate, truth_path
from synth.rig.virtual_rig import RigOptions, VirtualRig

FRAMES, SUBJECTS, FRAMES_PER_SECOND, FIRST_SEED = 24, 8, 0.5, 69001
SCORES = ("mean_recall", "person_iou", "left_right_swap_rate")


class Cold(FrameSource):
    """Frame source that drops the temperatures of a recording."""

    def __init__(self, source: FrameSource) -> None:
        self._source, self.calibration, self.name = source, source.calibration, source.name
        self.times_ns, self.subject = source.times_ns, source.subject

    def _frame(self, index: int) -> RigFrame:
        return replace(self._source.frame(index), thermal_c=None)


def main() -> None:
    """Print a line for each recording."""
    network = OnnxNetwork()
    for number, (scene, difficulty) in enumerate(product(SCENES, ("normal", "hard"))):
        rig = VirtualRig(
            FRAMES, SUBJECTS, difficulty, FIRST_SEED + number, RigOptions(scene, FRAMES_PER_SECOND)
        )
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "session.mcap"
            simulate(rig, path, lambda n: None)
            truth, session = LabelSet.open(truth_path(path)), Session(path)
            for kind, source in (("thermal", session), ("depth alone", Cold(session))):
                for name, readers in (("network", ()), ("again", (shipped_refinement_network(),))):
                    out = Path(folder) / f"{kind} {name}"
                    options = PredictOptions(refiners=readers)
                    found = predict_source(source, network, out, lambda n: None, options).labels
                    scores = compare_sets(found, truth).scores
                    figures = ", ".join(f"{float(scores[score]):.4f}" for score in SCORES)
                    print(f"{scene}, {difficulty}, {kind}, {name}: {figures}", flush=True)


if __name__ == "__main__":
    main()

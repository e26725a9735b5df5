"""The whole path in one function: simulate, label, correct, predict, evaluate, report."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction.correction import Correction
from annotate.effort.annotator import WHO, Annotator, correct_set
from annotate.label_source import label_source
from annotate.labelset.store import LabelSet
from cli.console import progress
from eval.compare.compare import compare_sets
from eval.compare.results import Result, save_result
from eval.network.onnx_network import THINGS_WEIGHTS, OnnxNetwork
from eval.network.predict_source import predict_source
from eval.report.build import write_report
from eval.report.gather import gather
from sensors.session.reader import Session
from synth.rig.paths import truth_path
from synth.rig.simulate import simulate
from synth.rig.virtual_rig import VirtualRig


def whole_path(out: Path, frames: int, seed: int) -> dict[str, Any]:
    """Run every step on frames of the virtual rig, into the folder ``out``; the scores of each step."""
    rig = VirtualRig(frames, min(4, frames), "normal", seed)
    session_path = out / "session.mcap"
    with progress("simulate", frames) as advance:
        simulate(rig, session_path, advance)
    session, truth = Session(session_path), LabelSet.open(truth_path(session_path))
    with progress("label", frames) as advance:
        automatic = label_source(session, rig.suit, out / "automatic", advance).labels
    fuser = Fuser(session.calibration)

    def fused(frame_id: str) -> ThermalCloud:
        return fuser.fuse_frame(session.frame(int(frame_id)))

    corrected, seconds = _correct_all(automatic, truth, fused, out / "corrected")
    with progress("predict", frames) as advance:
        predicted = predict_source(
            session, OnnxNetwork(), out / "network", advance, things=OnnxNetwork(THINGS_WEIGHTS)
        ).labels

    sets = {"Automatic": automatic, "Corrected": corrected, "Network": predicted}
    compared = {name: compare_sets(labels, truth) for name, labels in sets.items()}
    facts = {"command": f"annotate-cloud demo --frames {frames} --seed {seed}", "session": session.sha256}
    results = []
    for name, labels in sets.items():
        paths = {"predicted": str(labels.path), "truth": str(truth.path)}
        results.append(Result(name, compared[name], {**facts, **paths}))
        save_result(out / f"{name.lower()}.npz", results[-1])
    material = gather(results, sessions=[session], audited=[corrected.path], facts=facts)
    write_report(out / "report.html", material)
    summary = {
        name: {score: float(one.scores[score]) for score in ("mean_recall", "miou")}
        for name, one in compared.items()
    }
    return {
        "frames": frames,
        "auto": summary["Automatic"],
        "corrected": summary["Corrected"],
        "fcn": summary["Network"],
        "person_iou": float(compared["Automatic"].scores["person_iou"]),
        "effort_seconds_median": float(np.median(seconds)),
        "report": str(out / "report.html"),
    }


def _correct_all(
    automatic: LabelSet, truth: LabelSet, cloud_of: Callable[[str], ThermalCloud], out: Path
) -> tuple[LabelSet, list[float]]:
    """A copy of the labels, corrected by the simulated annotator, and the seconds of each frame."""
    shutil.copytree(automatic.path, out)
    annotator = Annotator()
    with Correction.open(out, WHO, clock=annotator.clock) as correction:
        efforts = correct_set(correction, truth, annotator, cloud_of)
        return correction.labels, [effort.seconds for effort in efforts]

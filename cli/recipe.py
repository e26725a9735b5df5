"""The whole path in one function: simulate, label, correct, predict, evaluate, report."""

import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction.correction import Correction
from annotate.effort.annotator import WHO, Annotator, correct_set
from annotate.label_recording import SuitLabeller, label_source
from annotate.labelset.label_set import LabelSet
from cli.console import progress
from eval.compare.compare import compare_sets
from eval.compare.results import Result, save_result
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict_source import predict_source
from eval.report.gather import gather
from eval.report.page import write_report
from sensors.session.reader import Session
from synth.rig.simulate import simulate, truth_path
from synth.rig.virtual_rig import VirtualRig


def whole_path(out: Path, frames: int, seed: int) -> dict[str, Any]:
    """Run every step on frames of the virtual rig, into the folder ``out``; the scores of each step."""
    rig = VirtualRig(frames, min(4, frames), "normal", seed)
    session_path = out / "session.mcap"
    with progress("simulate", frames) as advance:
        simulate(rig, session_path, advance)
    session, truth = Session(session_path), LabelSet.open(truth_path(session_path))
    with ThreadPoolExecutor(1) as beside:
        # The network needs no labels: it works while these are made and corrected.
        predicting = beside.submit(_predict, session_path, out / "network")
        with progress("label", frames) as advance:
            automatic = label_source(session, SuitLabeller(rig.suit), out / "automatic", advance).labels
        corrected, seconds = _correct_all(automatic, truth, session, out / "corrected")
        predicted = predicting.result()

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


def _predict(session: Path, out: Path) -> LabelSet:
    """Labels by the network."""
    return predict_source(Session(session), OnnxNetwork(), out, lambda _: None).labels


def _correct_all(
    automatic: LabelSet, truth: LabelSet, session: Session, out: Path
) -> tuple[LabelSet, list[float]]:
    """A copy of the labels, corrected by the simulated annotator, and the seconds of each frame."""
    fuser = Fuser(session.calibration)

    def cloud_of(frame_id: str) -> ThermalCloud:
        return fuser.fuse_frame(session.frame(int(frame_id)))

    shutil.copytree(automatic.path, out)
    annotator = Annotator()
    with Correction.open(out, WHO, clock=annotator.clock) as correction:
        efforts = correct_set(correction, truth, annotator, cloud_of)
        return correction.labels, [effort.seconds for effort in efforts]

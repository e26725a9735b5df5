"""The verb ``demo``: simulate, label, correct, predict, evaluate and report on the virtual rig."""

import shutil
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from cli.console import Json, Overwrite, clear, finish, progress, table
from cli.extras import needing
from sensors.files.atomic import check_folder_name, check_free, write_bytes

if TYPE_CHECKING:
    from annotate.labelset.label_set import LabelSet
    from sensors.session.reader import Session

MARKER = ".annotate-cloud-demo"


def demo(
    out: Annotated[Path, Option(help="Folder for all results of the demo.")],
    frames: Annotated[int, Option(min=1, help="Number of frames, of up to four people.")] = 8,
    seed: Annotated[int, Option(min=0, help="The same seed gives the same people and poses.")] = 1,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Run all steps on the virtual rig, from recording to report."""
    check_folder_name(out)
    check_free(out, overwrite, folder=True)
    with needing("synth", "report"):
        from eval.report import page  # noqa: F401
        from synth.rig import simulate  # noqa: F401

    started = time.monotonic()
    clear(out, MARKER, overwrite)
    check_free(out, overwrite=False)
    out.mkdir(parents=True)
    write_bytes(out / MARKER, b"")

    result = _all_steps(out, frames, seed)
    result["seconds"] = round(time.monotonic() - started, 1)
    sets = {"automatic": result["auto"], "corrected": result["corrected"], "network": result["fcn"]}
    rows = [(name, scores["mean_recall"], scores["miou"]) for name, scores in sets.items()]
    scores = table(("labels", "mean recall", "mIoU"), rows)
    finish(result, json, scores, "", f"report: {result['report']}")


def _all_steps(out: Path, frames: int, seed: int) -> dict[str, Any]:
    """Run every step into the folder ``out``; return the scores of each step."""
    from annotate.label_recording import SuitLabeller, label_source
    from annotate.labelset.label_set import LabelSet
    from eval.compare.compare import compare_sets
    from eval.compare.results import Result, save_result
    from eval.report.gather import Sources, gather
    from eval.report.page import write_report
    from sensors.session.reader import Session
    from synth.rig.simulate import simulate, truth_path
    from synth.rig.virtual_rig import VirtualRig

    rig = VirtualRig(frames, min(4, frames), "normal", seed)
    session_path = out / "session.mcap"
    with progress("simulate", frames) as advance:
        simulate(rig, session_path, advance)
    session, truth = Session(session_path), LabelSet.open(truth_path(session_path))
    with ThreadPoolExecutor(1) as beside:
        # The network needs no labels, so it runs beside labelling and correction.
        predicting = beside.submit(_predict, session_path, out / "network")
        with progress("label", frames) as advance:
            automatic = label_source(session, SuitLabeller(rig.suit), out / "automatic", advance).labels
        corrected, median_s = _correct_all(automatic, truth, session, out / "corrected")
        predicted = predicting.result()

    sets = {"Automatic": automatic, "Corrected": corrected, "Network": predicted}
    compared = {name: compare_sets(labels, truth) for name, labels in sets.items()}
    facts = {"command": f"annotate-cloud demo --frames {frames} --seed {seed}", "session": session.sha256}
    results = []
    for name, labels in sets.items():
        paths = {"predicted": str(labels.path), "truth": str(truth.path)}
        results.append(Result(name, compared[name], {**facts, **paths}))
        save_result(out / f"{name.lower()}.npz", results[-1])
    material = gather(Sources(results, sessions=[session], audited=[corrected.path], facts=facts))
    write_report(out / "report.html", material)
    auto, by_hand, fcn = (
        {score: float(one.scores[score]) for score in ("mean_recall", "miou")} for one in compared.values()
    )
    person_iou, report = float(compared["Automatic"].scores["person_iou"]), str(out / "report.html")
    scores = {"frames": frames, "auto": auto, "corrected": by_hand, "fcn": fcn, "person_iou": person_iou}
    return {**scores, "effort_seconds_median": median_s, "report": report}


def _predict(session: Path, out: Path) -> "LabelSet":
    from eval.network.onnx_network import OnnxNetwork
    from eval.network.predict_source import predict_source
    from sensors.session.reader import Session

    return predict_source(Session(session), OnnxNetwork(), out, lambda _: None).labels


def _correct_all(
    automatic: "LabelSet", truth: "LabelSet", session: "Session", out: Path
) -> tuple["LabelSet", float]:
    """Return a copy of the labels, corrected by the simulated annotator, and its median seconds a frame."""
    import numpy as np

    from annotate.cloud.fuse import Fuser
    from annotate.correction.correction import Correction
    from annotate.effort.annotator import WHO, Annotator, correct_set

    fuser, annotator = Fuser(session.calibration), Annotator()
    shutil.copytree(automatic.path, out)
    with Correction.open(out, WHO, clock=annotator.clock) as correction:
        efforts = correct_set(
            correction, truth, annotator, lambda frame_id: fuser.fuse_frame(session.frame(int(frame_id)))
        )
        return correction.labels, float(np.median([effort.seconds for effort in efforts]))

"""Fine-tuning on corrections: train a network on them, then label the untouched frames."""

import json
import shutil
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from annotate.correction.correction import Correction
from annotate.correction.relabel import untouched
from annotate.labelset.atomic_folder import appearing
from annotate.labelset.cast_note import cast_note, cast_of
from annotate.labelset.claim import Claim, login
from annotate.labelset.label_set import MANIFEST, LabelSet
from annotate.labelset.scheme_note import scheme_note
from eval.fine_tuning.by_depth import DepthFineTuner
from eval.fine_tuning.by_suit import SuitFineTuner, suit_step
from eval.fine_tuning.cross_validation import Gain, cross_validate
from eval.fine_tuning.rehearsal import rehearsed_frames
from eval.fine_tuning.run import FineTuner
from eval.fine_tuning.training_split import corrected_frames
from eval.training.progress import Progress
from sensors.errors import ExistsError
from sensors.files.atomic import check_folder_name, is_taken, write_bytes

WEIGHTS, LABELS = "weights.onnx", "labels"
RECORD, RUN = "learnt.json", "run"
"""Files of a fine-tuning: the network, the set with its labels, the result, and the unfinished run."""


@dataclass(frozen=True)
class FineTuned:
    """Result of a fine-tuning.

    measured_on: ids of the corrected frames, each held out of one training. gain: on these. weights: file of
    the network, labels: its labels of the untouched frames; both None where the gain is not certain.
    """

    measured_on: tuple[str, ...]
    gain: Gain
    weights: Path | None = None
    labels: Path | None = None

    def fields(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        files = {"weights": self.weights, "labels": self.labels}
        return {
            "frames": len(self.measured_on),
            "measured_on": list(self.measured_on),
            **asdict(self.gain),
            "text": self.gain.text,
            **{name: str(path) if path else None for name, path in files.items()},
        }


def fine_tuner_of(labels: LabelSet, session: Path | None, start: Path | None) -> FineTuner:
    """Return the fine-tuner for a label set: of the suit network for labels by a suit, else of the refinement
    network.

    session: recording of labels by a suit; None = the one beside them. start: weights to start from; None =
    the shipped ones. Raises CloudError where one of them is missing or does not fit.
    """
    return SuitFineTuner(labels, session, start) if suit_step(labels) else DepthFineTuner(labels, start)


def check_folder(out: Path) -> None:
    """Raise ExistsError for a folder that no fine-tuning wrote, CloudError for a name of a file."""
    check_folder_name(out)
    if is_taken(out) and not ((out / RECORD).is_file() or (out / RUN).is_dir()):
        raise ExistsError(f"{out} was not made by this command (it has no {RECORD}); choose another folder")


def fine_tune(path: Path, out: Path, tuner: FineTuner, progress: Progress) -> FineTuned:
    """Fine-tune on the accepted frames of the label set at ``path``, which stays unchanged.

    out: folder for the network and its labels; an interrupted run is resumed there. Raises CloudError for too
    few frames, ExistsError where ``out`` is another folder, ClaimedError while another process works there.
    """
    frames, rehearsed = corrected_frames(path), rehearsed_frames(path)
    check_folder(out)
    (out / RUN).mkdir(parents=True, exist_ok=True)
    with Claim.take(out, login()):
        gain = cross_validate(tuner, frames, rehearsed, out / RUN, progress)
        done = FineTuned(tuple(frame.first.frame_id for frame in frames), gain)
        if gain.is_certain:
            network = tuner.train(frames, rehearsed, out / RUN, progress)
            tuner.save(network, gain.share, out / WEIGHTS)
            _label(path, tuner, out, progress)
            done = replace(done, weights=out / WEIGHTS, labels=out / LABELS)
        names = {"weights": WEIGHTS, "labels": LABELS} if gain.is_certain else {}
        write_bytes(out / RECORD, (json.dumps(done.fields() | names, indent=1) + "\n").encode())
        shutil.rmtree(out / RUN, ignore_errors=True)
    return done


def _label(path: Path, tuner: FineTuner, out: Path, progress: Progress) -> None:
    """Label the untouched frames of the set at ``path`` by the new network, and write them as a new set."""
    with (
        Correction.open(path, read_only=True) as correction,
        appearing(out / LABELS, MANIFEST, path, overwrite=True) as folder,
        progress("label, frames", len(untouched(correction))) as advance,
    ):
        labels = correction.labels
        notes = cast_note(cast_of(labels.info)) | scheme_note(labels.scheme)
        info = {"source": labels.source, "steps": tuner.step(out / WEIGHTS), **notes}
        learnt = LabelSet.create(folder, labels.intrinsics, info)
        for labelled in tuner.labels(correction, out / WEIGHTS):
            learnt.write(labelled)
            advance(1)

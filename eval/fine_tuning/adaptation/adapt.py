"""Adaptation of the depth network to labelled recordings: train, compare on held-out people, export."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain, compress
from pathlib import Path
from typing import Any

import numpy as np
from torch import nn

from annotate.array_types import Float32, UInt8, UInt16
from annotate.labelset.claim import Claim, login
from annotate.labelset.dataset import Dataset, sha256
from annotate.labelset.journal import JOURNAL
from annotate.labelset.json_object import read_object
from annotate.parts import PAPER
from annotate.scheme.scheme import Scheme
from eval.architecture.networks import NetworkConfig, scheme_of
from eval.fine_tuning.adaptation.adaptation_gain import SHARES, AdaptationGain
from eval.fine_tuning.adaptation.adaptation_split import AdaptationSplit, HeldOut, split_of
from eval.fine_tuning.adaptation.adaptation_training import AdaptationTraining, trained, work_left
from eval.fine_tuning.adaptation.judges import Judges
from eval.fine_tuning.adaptation.labelled_people import (
    LabelledPerson,
    TaughtFrames,
    chosen_frames,
    people_in,
)
from eval.fine_tuning.weights_between import between
from eval.network.onnx_export import export_network, leave_unrefined
from eval.network.onnx_network import SHIPPED_WEIGHTS, OnnxNetwork
from eval.network.refine import SHIPPED_REFINEMENT_NETWORK
from eval.network.weights_file import load_weights
from eval.training.body_targets import body_targets
from eval.training.calibration.calibrated_export import calibrated, export_calibrated
from eval.training.crops import DEPTH_STEPS, Crops, to_crop
from eval.training.expansion import expanded
from eval.training.plan import ModernRecipe, Plan, fastest_precision
from eval.training.progress import Progress
from sensors.errors import ExistsError, FormatError, Setting
from sensors.files.atomic import is_taken, write_bytes
from synth.data_files import TRAINING
from synth.images import workers
from synth.images.generate import Order, generate
from synth.images.presets import preset_named

WEIGHTS, RECORD, ORDER = "weights.onnx", "adapted.json", "adapt.json"
SYNTHETIC, TRAINED, TRIAL = "synthetic", "training", "trial.onnx"
"""Files of an adaptation: network, result, names of the label sets; images, training, trial network."""
IMAGES, SHARD, CHECKED = 640, 64, 2  # synthetic images, in shards; one of two people is left out; untuned
RECIPE = ModernRecipe(batch=16, peak_rate=3e-4, averaged=0.99, coarse=0.0, statistics=False)
SEED = 0  # of synthetic images


@dataclass(frozen=True)
class Adapted:
    """Result of an adaptation. weights: file of the network; None where no gain is certain and harmless."""

    gain: AdaptationGain
    weights: Path | None = None

    def fields(self) -> dict[str, Any]:
        """Return the result as JSON values."""
        weights = str(self.weights) if self.weights else None
        return {**asdict(self.gain), "text": self.gain.text, "weights": weights}

    @classmethod
    def read(cls, folder: Path) -> "Adapted":
        """Return the result in a folder. Raises FormatError for a file that holds none, and for a missing
        network.
        """
        path = folder / RECORD
        try:
            fields = read_object(path)
            weights = fields.pop("weights")
            if weights not in (None, WEIGHTS):
                raise ValueError(weights)
            found = cls(AdaptationGain.of_fields(fields), folder / weights if weights else None)
        except (FormatError, ValueError, KeyError, TypeError, OverflowError) as error:
            raise FormatError(f"{path} holds no result; remove the file to compare again") from error
        if found.weights and not found.weights.is_file():
            raise FormatError(f"{found.weights} is missing; remove {path} to compare again")
        return found


@dataclass(frozen=True)
class Start:
    """Network to start from, whose classes are the labels' or finer, and the shipped file it stands for."""

    model: nn.Module
    config: NetworkConfig
    shipped: Path

    @classmethod
    def of(cls, scheme: Scheme) -> "Start":
        """Return the shipped network for a scheme."""
        model, config, own = load_weights(SHIPPED_WEIGHTS.with_suffix(".safetensors"))
        return cls(expanded(model, config, own, scheme), config, SHIPPED_WEIGHTS)

    @property
    def scheme(self) -> Scheme:
        """Return the scheme of the network's classes."""
        return scheme_of(self.model, PAPER)


def planned(config: NetworkConfig, minutes: float) -> Plan:
    """Return the plan of the training."""
    return Plan(config, RECIPE, minutes=minutes, precision=fastest_precision())


def adapt(sets: Sequence[TaughtFrames], out: Path, minutes: float, progress: Progress) -> Adapted:
    """Adapt the shipped depth network to label sets of one scheme, in a folder; resume an interrupted run.

    minutes: of training. A finished run gives its result again. Raises CloudError for too few labels, and
    then writes nothing; ExistsError where ``out`` holds something else, ClaimedError while another process
    works there.
    """
    order = order_of(sets, minutes)
    if (done := finished(out, order)) is not None:
        return done
    people = found_people(sets, progress)
    held = HeldOut.of(people)
    begin(out, order)
    with Claim.take(out, login()):
        split = prepared(people, held, (sets[0].labels.scheme, out / SYNTHETIC), progress)
        start = Start.of(split.crops.scheme)
        training = AdaptationTraining(split, start.model, planned(start.config, minutes))
        (out / TRAINED).mkdir(exist_ok=True)
        left, unit = work_left(training, out / TRAINED)
        with progress(f"train, {unit}", left) as advance:
            last = trained(training, out / TRAINED, advance)
        judges = Judges(split, sets, list(compress(people, held.mask)))
        gain = judges.gain_of(networks_between(start, last, out / TRIAL, progress), progress)
        done = Adapted(gain, out / WEIGHTS if gain.is_certain else None)
        write(done, start, last, split.left_out, progress)
        fields = done.fields() | {"weights": WEIGHTS if done.weights else None}
        write_bytes(out / RECORD, (json.dumps(fields, indent=1) + "\n").encode())
    return done


def write(done: Adapted, start: Start, last: nn.Module, left_out: Crops, progress: Progress) -> None:
    """Write the network of a result, if any. left_out: crops that it was not trained on."""
    if done.weights is None:
        return
    final = between(start.model, last, done.gain.share)
    calibration = calibrated(final, left_out, progress)
    with progress("export, networks", 1) as advance:
        export_calibrated(final, start.config, start.scheme, calibration, done.weights)
        if not done.gain.refined:
            leave_unrefined(done.weights)
        advance(1)


def order_of(sets: Sequence[TaughtFrames], minutes: float) -> str:
    """Return what determines an adaptation, as JSON: label sets, corrections, network, length."""
    paths = [taught.labels.path.resolve() for taught in sets]
    journals = [sha256(path / JOURNAL) if (path / JOURNAL).is_file() else None for path in paths]
    named = {"labels": list(map(str, paths)), "corrections": journals, "start": sha256(SHIPPED_WEIGHTS)}
    refinement = sha256(SHIPPED_REFINEMENT_NETWORK)
    return json.dumps({**named, "refinement": refinement, "minutes": minutes}, indent=1) + "\n"


def finished(out: Path, order: str) -> Adapted | None:
    """Return the result of an order's finished adaptation in a folder; None before it is finished.

    Raises ExistsError for a folder with another adaptation or with something else.
    """
    if not (out / ORDER).is_file():
        if is_taken(out):
            raise ExistsError(f"{out} already exists; choose another folder")
        return None
    if (out / ORDER).read_bytes() != order.encode():
        raise ExistsError(f"{out} holds another adaptation; choose another folder", Setting.OVERWRITE)
    return Adapted.read(out) if (out / RECORD).is_file() else None


def begin(out: Path, order: str) -> None:
    """Write the order of an adaptation into its folder."""
    out.mkdir(parents=True, exist_ok=True)
    write_bytes(out / ORDER, order.encode())


def found_people(sets: Sequence[TaughtFrames], progress: Progress) -> list[LabelledPerson]:
    """Return the labelled people of label sets."""
    people, chosen = list[LabelledPerson](), chosen_frames(sets)
    with progress("find people, frames", len(chosen)) as advance:
        for number, frame_id in chosen:
            people += people_in(sets[number], number, frame_id)
            advance(1)
    return people


def prepared(
    people: Sequence[LabelledPerson], held: HeldOut, rehearsal: tuple[Scheme, Path], progress: Progress
) -> AdaptationSplit:
    """Return the crops of labelled and of synthetic people.

    rehearsal: scheme of the synthetic people, and the folder into which they are generated.
    """
    scheme, folder = rehearsal
    preset = replace(preset_named("people", TRAINING), scheme=scheme)
    order = Order(preset, IMAGES, SEED, SHARD)
    with progress("generate, images", IMAGES) as advance, workers.processes(2) as hands:
        rehearsed = generate(order, folder, hands, advance).dataset
    crops = Crops.of(chain(((p.depth, p.parts, p.row) for p in people), _crops_of(rehearsed)), scheme=scheme)
    checked = [n // preset.each % CHECKED == 0 for n in range(len(crops) - len(people))]
    return split_of(held, checked, crops)


def networks_between(start: Start, last: nn.Module, trial: Path, progress: Progress) -> list[OnnxNetwork]:
    """Return the shipped network, then networks between start and last by ``SHARES``. trial: their file."""
    networks = [OnnxNetwork(start.shipped)]
    with progress("export, networks", len(SHARES)) as advance:
        for share in SHARES:
            export_network(between(start.model, last, share), trial, scheme=start.scheme)
            networks.append(OnnxNetwork(trial))
            advance(1)
    trial.unlink()
    return networks


def _crops_of(rehearsed: Dataset) -> Iterator[tuple[UInt16, UInt8, Float32]]:
    """Yield the crops of synthetic people with their rows of ``body_targets``."""
    for frame in rehearsed:
        depth, parts = to_crop(frame)
        yield np.rint(depth * DEPTH_STEPS).astype(np.uint16), parts, body_targets(rehearsed, frame)

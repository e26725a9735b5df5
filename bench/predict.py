"""Time of prediction, beside the paper's FCN and a naive crop and paste."""

import statistics
import tempfile
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from annotate.cloud.coarse import CoarseCloud
from annotate.cloud.fuse import Fuser
from annotate.crop import SIZE, crop_around
from annotate.label_recording import label_cloud
from annotate.labelset.dataset import MANIFEST, SCHEMA, Dataset, encode_shard, sha256
from annotate.labelset.label_set import LabelSet
from annotate.labelset.scheme_note import scheme_note
from annotate.segmentation.labels_of_frame import labels_of
from eval.network.onnx_network import OnnxNetwork
from eval.network.predict import BATCH, PredictOptions, predict_frames
from eval.network.predict_source import NetworkLabeller, predict_source
from eval.network.refine import shipped_refinement_network
from sensors.rig.frame import FrameSource, RigFrame
from sensors.rig.rig_calibration import RigCalibration
from synth.images.presets import preset_named, sample
from synth.rig.truth import truth_labels
from synth.rig.virtual_rig import VirtualRig

FRAMES, REPEATS, PAPER_REPEATS = 4, 25, 3
CROPS, RECORDED = 64, 5


class Silent(OnnxNetwork):
    """Network that returns stored outputs, so that only the work around a network takes time."""

    @cache  # noqa: B019
    def _stored(self, n):
        return super().outputs(np.full((n, SIZE, SIZE), 0.5, np.float32))

    def outputs(self, crops):
        return self._stored(len(crops))


def paper_network(folder):
    """Return the paper's FCN with random weights, exported: 135 million parameters, 540 MB."""
    import torch

    from eval.architecture.reference_networks import PaperFcn
    from eval.network.onnx_export import export_network

    torch.manual_seed(0)
    export_network(PaperFcn(), folder / "paper.onnx")
    return OnnxNetwork(folder / "paper.onnx")


def segment_naive(network, depth_mm, person):
    """Label pixel by pixel in Python: enlarge every class to the image, then take the most likely class."""
    mask = person & (depth_mm > 0)
    crop = crop_around(mask)
    depth = np.zeros((SIZE, SIZE), np.float32)
    middle = np.median(depth_mm[mask])
    for i in range(SIZE):
        for j in range(SIZE):
            v, u = (c + int((k + 0.5) * crop.side / SIZE) for c, k in ((crop.top, i), (crop.left, j)))
            if 0 <= v < mask.shape[0] and 0 <= u < mask.shape[1] and mask[v, u]:
                depth[i, j] = min(max((depth_mm[v, u] - middle) / 2000 + 0.5, 1 / 2000), 1)
    planes = network.probabilities(depth[None])[0]
    image = np.zeros((len(planes), *mask.shape), np.float32)
    for v, u in np.argwhere(mask):
        i, j = ((k - c) * SIZE // crop.side for k, c in ((v, crop.top), (u, crop.left)))
        image[:, v, u] = planes[:, i, j]
    return np.where(mask, image[1:].argmax(axis=0) + 1, 0)


def seconds(function, images, repeats):
    """Return the median over frames and repeats, after one run to warm up."""
    function(*images[0])
    times = []
    for k in range(repeats):
        start = time.perf_counter()
        function(*images[k % len(images)])
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def dataset_seconds(folder, network):
    """Return seconds a frame of ``predict`` on a dataset, read and written; eight at once, and singly."""
    shard = folder / "d" / "shard-000000.tar"
    shard.parent.mkdir()
    preset = preset_named("sitting-test")
    shard.write_bytes(encode_shard(sample(preset, 99, i) for i in range(CROPS)))
    entry = f'{{"file": "{shard.name}", "sha256": "{sha256(shard)}"}}'
    (shard.parent / MANIFEST).write_text(f'{{"schema": {SCHEMA}, "images": {CROPS}, "shards": [{entry}]}}')
    taken = []
    for batch in (BATCH, 1):
        start = time.perf_counter()
        data, options = Dataset.open(shard.parent), PredictOptions(batch=batch)
        predict_frames(data, network, folder / str(batch), lambda n: None, options)
        taken.append((time.perf_counter() - start) / CROPS)
    return taken


class Played(FrameSource):
    """Source of rendered frames of a rig."""

    def __init__(self, frames: list, calibration: RigCalibration) -> None:
        self.frames, self.calibration, self.name = frames, calibration, "played"
        self.times_ns = np.array([frame.stamp_ns for frame in frames], np.int64)

    def _frame(self, index: int) -> RigFrame:
        return self.frames[index]


def recording_seconds(folder, rig, network, again):
    """Return seconds a frame of ``predict`` on a recording, and of frames one after the other.

    again: network that refines the labels, None = unrefined.
    """
    frames = [replace(frame, index=k) for k, frame in enumerate([*rig] * RECORDED)]
    warm, source = Played(frames[:FRAMES], rig.calibration), Played(frames, rig.calibration)
    options = PredictOptions(room_refiner=again)
    predict_source(warm, network, folder / "warm", lambda n: None, options)
    start = time.perf_counter()
    predict_source(source, network, folder / "recording", lambda n: None, options)
    ours = (time.perf_counter() - start) / len(frames)
    start = time.perf_counter()
    label_singly(frames[:FRAMES], rig.calibration, NetworkLabeller(network, options), folder / "singly")
    return ours, (time.perf_counter() - start) / FRAMES


def label_singly(frames, calibration, labeller, out):
    """Label frames of whole clouds one after the other; read, label and write nothing ahead."""
    fuser = Fuser(calibration)
    labels = LabelSet.create(out, fuser.camera, scheme_note(labeller.scheme))
    for frame in frames:
        cloud = fuser.fuse_frame(frame)
        result, person = label_cloud(labeller, CoarseCloud.of(cloud), None)
        labels.write(labels_of(str(frame.index), cloud.depth_mm, result, person))


def bench():
    """Return rows (name, seconds a frame, seconds a frame of the other way)."""
    rig = VirtualRig(FRAMES, 2, "normal", 77)
    truths = [truth_labels(frame, known) for frame, known in rig.with_truth()]
    images = [(frame.depth_mm, frame.parts > 0) for frame in truths]
    network, silent = OnnxNetwork(), Silent()
    one = seconds(network.segment, images, REPEATS)
    around = seconds(silent.segment, images, REPEATS)
    naive = seconds(lambda *image: segment_naive(silent, *image), images, PAPER_REPEATS)
    with tempfile.TemporaryDirectory() as folder:
        batched, singly = dataset_seconds(Path(folder), network)
        again, alone = (
            recording_seconds(Path(folder) / name, rig, network, reader)
            for name, reader in (("again", shipped_refinement_network()), ("alone", None))
        )
        paper = seconds(paper_network(Path(folder)).segment, images, PAPER_REPEATS)
    return [
        ("predict: crop, network, paste; beside the paper's FCN", one, paper),
        ("predict: crop and paste alone; beside Python loops", around, naive),
        ("predict: recording, all of it; whole clouds, one by one", *again),
        ("predict: recording, unrefined; whole clouds, one by one", *alone),
        ("predict: dataset, read and written; one frame at once", batched, singly),
    ]

"""Training in the scheme of the data: crops, losses, augmentation, and the data set for PyTorch."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from annotate.frame_labels import FrameLabels  # noqa: E402
from annotate.labelset.label_set import LabelSet  # noqa: E402
from annotate.labelset.scheme_note import scheme_note  # noqa: E402
from annotate.parts import PAPER  # noqa: E402
from annotate.scheme.merging import class_sums, conversion_table  # noqa: E402
from annotate.scheme.scheme_file import load_scheme  # noqa: E402
from eval.architecture.networks import build  # noqa: E402
from eval.scores.confusion import mean_recall  # noqa: E402
from eval.training.augment import Augmentation, augment  # noqa: E402
from eval.training.body_targets import no_targets  # noqa: E402
from eval.training.calibration.confidence_temperature import fitted_temperature  # noqa: E402
from eval.training.calibration.deviation_factors import fitted_deviation_factors  # noqa: E402
from eval.training.crops import Crops, load_crops, to_crop  # noqa: E402
from eval.training.plan import Loss, ModernRecipe, Plan, class_weights  # noqa: E402
from eval.training.processes import ProcessGroup  # noqa: E402
from eval.training.torch_dataset import TorchDataset  # noqa: E402
from eval.training.train import Data, evaluate, predicted, train  # noqa: E402
from sensors.errors import CloudError, FormatError  # noqa: E402
from sensors.rig.camera import Intrinsics  # noqa: E402
from tests.helpers.schemes import WARD  # noqa: E402
from tests.test_scheme_networks import REGIONS, TINY  # noqa: E402

SIX, HANDS = load_scheme("six"), load_scheme("hands-and-feet")
CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)


def frame_of(scheme, seed):
    """Blocks of all parts and things, in front of a background without depth."""
    rng = np.random.default_rng(seed)
    blocks = rng.choice(scheme.class_ids, (6, 8))
    parts = np.kron(blocks, np.ones((8, 8), np.uint8)).astype(np.uint8)
    parts[rng.random(parts.shape) < 0.02] = 255
    depth = rng.integers(1500, 2200, parts.shape).astype(np.uint16)
    depth[rng.random(parts.shape) < 0.1] = 0
    parts[(depth == 0) & (parts != 255)] = 0
    return FrameLabels(f"{seed:06d}", depth, parts, subject=f"P{seed % 3}", status="truth", scheme=scheme)


def set_of(path, scheme, count=4):
    labels = LabelSet.create(path, CAMERA, {"source": "made"} | scheme_note(scheme))
    for seed in range(count):
        labels.write(frame_of(scheme, seed))
    return labels


@pytest.mark.parametrize("scheme", [WARD, REGIONS], ids=lambda scheme: scheme.name)
def test_crops_in_a_coarser_scheme_are_the_converted_crops(tmp_path, scheme):
    path = set_of(tmp_path / "set", scheme).path
    own, coarse = load_crops([path]), load_crops([path], scheme=SIX)
    assert own.scheme == scheme and coarse.scheme == SIX
    table = conversion_table(scheme, SIX)
    for i in range(len(own)):
        np.testing.assert_array_equal(coarse.parts(i), table[own.parts(i)])
        np.testing.assert_array_equal(coarse.depth(i), own.depth(i))


def test_sources_of_several_schemes_need_one_that_they_convert_to(tmp_path):
    paths = [set_of(tmp_path / scheme.name, scheme).path for scheme in (PAPER, HANDS)]
    with pytest.raises(CloudError, match="give a scheme"):
        load_crops(paths)
    assert load_crops(paths, scheme=PAPER).scheme == PAPER
    with pytest.raises(FormatError, match="several parts"):
        load_crops(paths, scheme=HANDS)


@pytest.mark.parametrize("scheme", [SIX, WARD, REGIONS], ids=lambda scheme: scheme.name)
def test_augmented_parts_are_of_the_scheme_and_a_mirror_swaps_twins(scheme):
    depth, parts = to_crop(frame_of(scheme, 0))
    for seed in range(10):
        _, made, _ = augment(
            (depth, parts, no_targets()), Augmentation(), np.random.default_rng(seed), scheme
        )
        assert scheme.unknown_ids(made).size == 0
    alone = Augmentation(*([False] * 9))
    one, other = (
        augment((depth, parts, no_targets()), how, np.random.default_rng(3), scheme)[1]
        for how in (alone, Augmentation(True, *([False] * 8)))
    )
    swapped = scheme.swap_left_right(one[:, ::-1])
    assert np.mean(other == one) > 0.8 or np.mean(other == swapped) > 0.8


@pytest.mark.parametrize("scheme", [SIX, WARD, REGIONS], ids=lambda scheme: scheme.name)
def test_a_loss_counts_classes_by_id(scheme):
    frame = frame_of(scheme, 1)
    depth, parts = to_crop(frame)
    weight = class_weights(ModernRecipe(), parts[None], scheme)
    assert len(weight) == len(scheme.class_ids)
    scores = torch.randn(1, len(weight), *parts.shape, generator=torch.Generator().manual_seed(0))
    target = scheme.class_table[parts].astype(np.int64)
    target[depth == 0] = 255
    summed = torch.nn.functional.cross_entropy(
        scores, torch.from_numpy(target[None]), weight, ignore_index=255, reduction="sum"
    )
    output = build(TINY, scheme)(torch.zeros(1, 1, 32, 32))._replace(
        scores=scores, facing=None, posture=None, joints=None
    )
    batch = torch.from_numpy(depth[None, None]), torch.from_numpy(parts[None]), torch.zeros(1, 3)
    _, mean = Loss(ModernRecipe(), weight, scheme=scheme).of(output, batch)
    assert mean == pytest.approx(float(summed) / (target != 255).sum(), rel=1e-5)


def test_a_network_of_regions_is_also_trained_on_the_sums_that_are_the_papers_parts():
    frame = frame_of(REGIONS, 1)
    depth, parts = to_crop(frame)
    loss = Loss.weighed(ModernRecipe(), parts[None], scheme=REGIONS)
    assert Loss.weighed(ModernRecipe(), parts[None], scheme=WARD).paper_weight is None
    scores = torch.randn(1, 25, *parts.shape, generator=torch.Generator().manual_seed(0))
    output = build(TINY, REGIONS)(torch.zeros(1, 1, 32, 32))._replace(
        scores=scores, facing=None, posture=None, joints=None
    )
    batch = torch.from_numpy(depth[None, None]), torch.from_numpy(parts[None]), torch.zeros(1, 3)
    both, alone = (one.of(output, batch)[0] for one in (loss, replace(loss, paper_weight=None)))
    seen = (depth > 0) & (parts != 255)
    sums = class_sums(torch.softmax(scores[0], 0).numpy(), REGIONS, PAPER)[:, seen]
    classes = PAPER.class_table[conversion_table(REGIONS, PAPER)[parts[seen]]]
    of_paper = -np.log(sums[classes, np.arange(seen.sum())]) * loss.paper_weight.numpy()[classes]
    assert float(both - alone) == pytest.approx(of_paper.mean(), rel=1e-4)


def test_a_training_in_a_scheme_with_gaps_predicts_and_counts_its_ids(tmp_path):
    torch.set_num_threads(1)
    crops = load_crops([set_of(tmp_path / "set", WARD).path])
    small = Crops.of(
        (
            (crops.depth(i)[::4, ::4][:52, :52], crops.parts(i)[::4, ::4][:52, :52], no_targets())
            for i in range(4)
        ),
        scheme=WARD,
    )
    plan = Plan(TINY, ModernRecipe(2), epochs=1)
    with ProcessGroup.join() as group:
        model, _ = train(Data(small, small), tmp_path / "run", plan, group)
    found = np.concatenate(list(predicted(model, small)))
    assert WARD.unknown_ids(found).size == 0
    total = evaluate(model, small)
    truth = np.concatenate([parts for _, parts in small.batches(4)])
    rows = [(truth == i).sum() for i in WARD.class_ids]
    np.testing.assert_array_equal(total.sum(axis=1), rows)
    columns = [((found == i) & (truth != 255)).sum() for i in WARD.class_ids]
    np.testing.assert_array_equal(total.sum(axis=0), columns)
    assert '"scheme"' in (tmp_path / "run" / "plan.json").read_text()


def test_a_network_of_regions_learns_from_coarser_labels_and_keeps_its_regions(tmp_path):
    torch.set_num_threads(1)
    whole = load_crops([set_of(tmp_path / "set", SIX).path])
    images = ((whole.depth(i)[::4, ::4][:52, :52], whole.parts(i)[::4, ::4][:52, :52]) for i in range(4))
    crops = Crops.of(((depth, parts, no_targets()) for depth, parts in images), scheme=SIX)
    start, plan = build(TINY, REGIONS), Plan(TINY, ModernRecipe(2), epochs=1)
    with ProcessGroup.join() as group:
        model, progress = train(Data(crops, crops, start), tmp_path / "t", plan, group)
    assert model(torch.zeros(1, 1, 32, 32)).scores.shape[1] == 25
    assert json.loads((tmp_path / "t" / "history.json").read_text())["scheme"]["name"] == REGIONS.name
    assert set(np.unique(next(predicted(model, crops)))) <= {0, *SIX.class_ids.tolist()}
    assert progress.epochs[0].mean_recall == mean_recall(evaluate(model, crops))
    assert fitted_temperature(model, crops) > 0 and len(fitted_deviation_factors(model, crops)) == 3


def test_the_data_set_for_pytorch_gives_crops_and_classes_at_random_places(tmp_path):
    labels = set_of(tmp_path / "set", WARD)
    empty = FrameLabels("000009", np.zeros(CAMERA.shape, np.uint16), np.zeros(CAMERA.shape, np.uint8))
    labels.write(FrameLabels(**vars(empty) | {"scheme": WARD}))
    data = TorchDataset(labels.path, scheme="six")
    assert len(data) == 5 and data.names == ("background", *(part.name for part in SIX.parts))
    for i in (3, 0, 2):
        depth, found = data[i]
        expected, parts = to_crop(frame_of(WARD, i))
        np.testing.assert_array_equal(depth[0], expected)
        classes = SIX.class_table[conversion_table(WARD, SIX)[parts]]
        np.testing.assert_array_equal(found, np.where(expected > 0, classes, 255))
        assert depth.dtype == torch.float32 and found.dtype == torch.int64
    depth, found = data[4]
    assert not depth.any() and (found == 255).all()
    again = pickle.loads(pickle.dumps(data))
    batch = next(iter(torch.utils.data.DataLoader(again, batch_size=5)))
    assert batch[0].shape == (5, 1, 212, 212)
    scores = torch.zeros(5, len(data.names), 212, 212)
    loss = torch.nn.functional.cross_entropy(scores, batch[1], ignore_index=255)
    assert float(loss) == pytest.approx(np.log(len(data.names)))

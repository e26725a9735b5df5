"""Train annotate/second_look/weights.npz on simulated sessions.

python -m tools.fit_second_look rows SESSION.mcap...       keeps SESSION.rows.npz beside each
python -m tools.fit_second_look train ROWS.npz... held-out ROWS.npz...   the latter tell how well it does
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.nn.functional import dropout, log_softmax, relu

from annotate.frame_labels import FrameLabels
from annotate.label_source import cleaned
from annotate.parts import BODY_PARTS, UNDEFINED, swap_left_right
from annotate.person.extract import Survey
from annotate.second_look.descriptors import LAYOUT, WIDTHS, descriptors, neighbour_pairs
from annotate.second_look.network import MOST_DEVIATIONS
from annotate.segmentation.segment import segment
from annotate.suit.palette import load_suit
from synth.rig.simulate import suit_path
from tools.fit_confidence import clouds

CLASSES = len(BODY_PARTS) + 1
HIDDEN, ROUNDS, DROPPED = 64, 3, 0.2
EPOCHS, BATCH, RATE, DECAY = 16, 8, 4e-3, 0.01
WORTH = np.ones(CLASSES, np.float32)
WORTH[[5, 6, 7, 10, 11]] = 1.5
"""Weight of a pixel of each class: recall is a mean over parts, and forearms are small."""
SEED = 0


@dataclass(frozen=True)
class Rows:
    """A frame's supervoxels: descriptors float32 (G, F), neighbours (e, 2), patch (G,); pixels of each
    of them by true class int32 (G, 13), the last of which is undefined."""

    described: np.ndarray
    edges: np.ndarray
    patch: np.ndarray
    pixels: np.ndarray


def observed(path: Path) -> list[Rows]:
    """What the second look has to go by in a session's frames, each after the labels of the one before."""
    suit, before, rows = load_suit(suit_path(path)), None, []
    for cloud, truth in clouds(path):
        person = Survey(cloud, None, suit).person(before)
        if not person.trusted:
            before = None
            continue
        first = segment(cloud, person.mask, suit, before)
        if (seen := person.candidates) is not None and first.reading is not None:
            groups, own = seen.clues.groups, seen.clues.compared
            true = np.where(truth == UNDEFINED, CLASSES, truth)[own].astype(np.intp)
            pixels = np.bincount(groups.ids * (CLASSES + 1) + true, minlength=groups.count * (CLASSES + 1))
            found = descriptors(cloud, person.mask, seen, first, before).astype(np.float32)
            pixels = pixels.reshape(groups.count, -1).astype(np.int32)
            pairs = neighbour_pairs(groups.centroids_m(cloud.points_m[own]))
            rows.append(Rows(found, pairs, seen.clues.patches.ids.astype(np.int32), pixels))
        labels, person = cleaned(first, person, cloud)
        persons = np.where(person.mask, 1, np.where(person.others, 2, 0)).astype(np.uint8)
        before = FrameLabels("x", cloud.depth_mm, labels.parts, labels.confidence, persons=persons)
    return rows


def save(rows: list[Rows], path: Path) -> None:
    names = ("described", "edges", "patch", "pixels")
    np.savez_compressed(
        path, **{f"{i}.{name}": getattr(one, name) for i, one in enumerate(rows) for name in names}
    )


def load(path: Path) -> list[Rows]:
    with np.load(path, allow_pickle=False) as stored:
        count = len({name.split(".")[0] for name in stored})
        return [
            Rows(*(stored[f"{i}.{name}"] for name in ("described", "edges", "patch", "pixels")))
            for i in range(count)
        ]


def mirrored(rows: Rows) -> Rows:
    """The frame as a mirror shows it: left and right exchanged, x the other way."""
    parts = swap_left_right(np.arange(CLASSES, dtype=np.uint8)).astype(np.intp)
    columns, signs, at = [], [], 0
    for kind in LAYOUT.values():
        order = {"parts": parts[1:] - 1, "classes": parts}.get(kind, np.arange(WIDTHS[kind]))
        columns.append(at + order)
        signs.append(np.array([-1, 1, 1]) if kind == "xyz" else np.ones(len(order)))
        at += len(order)
    found = rows.described[:, np.concatenate(columns)] * np.concatenate(signs).astype(np.float32)
    return Rows(found, rows.edges, rows.patch, rows.pixels[:, [*parts, CLASSES]])


class Graph(nn.Module):
    """``annotate.second_look.network.Network``, to be trained."""

    def __init__(self, columns: int) -> None:
        super().__init__()
        self.enter = nn.Linear(columns, HIDDEN)
        self.rounds = nn.ModuleList(nn.Linear(4 * HIDDEN, HIDDEN) for _ in range(ROUNDS))
        self.leave = nn.Linear(HIDDEN + columns, CLASSES)

    def forward(self, x: torch.Tensor, joined: "Joined") -> torch.Tensor:
        hidden = relu(self.enter(dropout(x, DROPPED, self.training)))
        for layer in self.rounds:
            heard = torch.cat([hidden, *joined.heard(hidden)], 1)
            hidden = hidden + dropout(relu(layer(heard)), DROPPED, self.training)
        return self.leave(torch.cat([hidden, x], 1))


class Joined:
    """How the supervoxels of several frames hear each other."""

    def __init__(self, frames: Sequence[Rows]) -> None:
        starts = np.cumsum([0, *(len(one.described) for one in frames)])
        patches = np.cumsum([0, *(one.patch.max() + 1 for one in frames)])
        edges = np.concatenate([one.edges + start for one, start in zip(frames, starts, strict=False)])
        self._a, self._b = torch.tensor(np.concatenate([edges, edges[:, ::-1]]).T.copy()).long()
        patch = np.concatenate([one.patch + start for one, start in zip(frames, patches, strict=False)])
        frame = np.repeat(np.arange(len(frames)), np.diff(starts))
        sizes = np.concatenate([one.pixels.sum(axis=1) for one in frames])
        self._sizes = torch.tensor(sizes[:, None], dtype=torch.float32)
        self._touching = torch.bincount(self._a, minlength=int(starts[-1]))[:, None].clamp(min=1)
        self._groups = [torch.tensor(patch).long(), torch.tensor(frame).long()]
        self._totals = [torch.bincount(ids, self._sizes[:, 0])[:, None] for ids in self._groups]

    def heard(self, hidden: torch.Tensor) -> list[torch.Tensor]:
        """What those that touch each say, its patch, its frame: means (n, H)."""
        touching = torch.zeros_like(hidden).index_add_(0, self._a, hidden[self._b]) / self._touching
        means = [touching]
        for ids, total in zip(self._groups, self._totals, strict=True):
            summed = torch.zeros(len(total), hidden.shape[1]).index_add_(0, ids, hidden * self._sizes)
            means.append((summed / total)[ids])
        return means


def trained(frames: Sequence[Rows], held_out: Sequence[Rows]) -> dict[str, np.ndarray]:
    """Weights as ``annotate.second_look.network.Network`` takes them."""
    every = np.concatenate([one.described for one in frames])
    middle, spread = every.mean(axis=0), every.std(axis=0) + 1e-3
    torch.manual_seed(SEED)
    rng, network = np.random.default_rng(SEED), Graph(len(middle))
    steps = EPOCHS * (len(frames) // BATCH)
    optimizer = torch.optim.AdamW(network.parameters(), RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, steps)

    def scores(batch: Sequence[Rows]) -> torch.Tensor:
        x = (np.concatenate([one.described for one in batch]) - middle) / spread
        return network(torch.tensor(x).clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS), Joined(batch))

    for epoch in range(EPOCHS):
        network.train()
        order = rng.permutation(len(frames))
        for step in range(len(frames) // BATCH):
            batch = [frames[i] for i in order[step * BATCH : (step + 1) * BATCH]]
            batch = [mirrored(one) if rng.random() < 0.5 else one for one in batch]
            pixels = torch.tensor(np.concatenate([one.pixels[:, :CLASSES] for one in batch]))
            lost = -(log_softmax(scores(batch), 1) * pixels * torch.tensor(WORTH)).sum() / pixels.sum()
            optimizer.zero_grad()
            lost.backward()
            nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimizer.step()
            schedule.step()
        network.eval()
        with torch.no_grad():
            told(epoch, np.concatenate([scores([one]).numpy() for one in held_out]), held_out)
    return {"middle": middle, "spread": spread, **matrices(network)}


def told(epoch: int, scores: np.ndarray, frames: Sequence[Rows]) -> None:
    """Print the mean recall over parts and the person's overlap, among the supervoxels."""
    pixels = np.concatenate([one.pixels[:, :CLASSES] for one in frames])
    table = np.zeros((CLASSES, CLASSES))
    np.add.at(table, scores.argmax(axis=1), pixels)
    recall = (table.diagonal() / table.sum(axis=0))[1:].mean()
    union = table.sum() - table[0, 0]
    print(f"epoch {epoch}: recall {recall:.4f}, person IoU {table[1:, 1:].sum() / union:.4f}", flush=True)


def matrices(network: Graph) -> dict[str, np.ndarray]:
    def matrix(layer: nn.Module) -> np.ndarray:
        return np.vstack([layer.weight.detach().numpy().T, layer.bias.detach().numpy()[None]])

    rounds = np.stack([matrix(layer) for layer in network.rounds])
    return {"enter": matrix(network.enter), "rounds": rounds, "leave": matrix(network.leave)}


def main(task: str, *names: str) -> None:
    torch.set_num_threads(1)
    paths = [Path(name) for name in names]
    if task == "rows":
        for path in paths:
            save(observed(path), path.with_suffix(".rows.npz"))
            print(path, flush=True)
        return
    cut = names.index("held-out")
    frames, held_out = (
        [one for path in part for one in load(path)] for part in (paths[:cut], paths[cut + 1 :])
    )
    print(len(frames), "frames,", len(held_out), "held out", flush=True)
    np.savez_compressed(Path("annotate/second_look/weights.npz"), **trained(frames, held_out))


if __name__ == "__main__":
    main(*sys.argv[1:])

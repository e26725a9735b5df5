"""The second look's network in torch, which is trained; labelling runs `annotate.second_look.network`."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import nn
from torch.nn.functional import dropout, log_softmax, relu

from annotate.array_types import Float32
from annotate.second_look.network import MOST_DEVIATIONS
from eval.training.engine_data import CLASSES, Rows
from sensors.errors import CloudError

HIDDEN, ROUNDS, DROPPED = 64, 3, 0.2
"""Width, message rounds, and share of inputs dropped in training; chosen by eye."""
EPOCHS, BATCH, RATE, DECAY = 16, 8, 4e-3, 0.01
"""Rounds over all frames, frames a step, highest learning rate and weight decay; chosen by eye."""
WORTH = np.ones(CLASSES, np.float32)
WORTH[[5, 6, 7, 10, 11]] = 1.5
"""Weight of a pixel by class: recall is a mean over parts, and forearms are small; chosen by eye."""
CLIP = 1.0
"""Largest norm of a gradient; chosen by eye."""


class Graph(nn.Module):
    """A network on supervoxels: each takes part in the means over its neighbours, patch and frame."""

    def __init__(self, columns: int) -> None:
        super().__init__()
        self.enter = nn.Linear(columns, HIDDEN)
        self.rounds = nn.ModuleList(nn.Linear(4 * HIDDEN, HIDDEN) for _ in range(ROUNDS))
        self.leave = nn.Linear(HIDDEN + columns, CLASSES)

    def forward(self, x: torch.Tensor, joined: "Joined") -> torch.Tensor:
        """Scores (n, 12) from standardised descriptors (n, F)."""
        x = x.clamp(-MOST_DEVIATIONS, MOST_DEVIATIONS)
        hidden = relu(self.enter(dropout(x, DROPPED, self.training)))
        for layer in self.rounds:
            around = torch.cat([hidden, *joined.means(hidden)], 1)
            hidden = hidden + dropout(relu(layer(around)), DROPPED, self.training)
        scores: torch.Tensor = self.leave(torch.cat([hidden, x], 1))
        return scores

    def arrays(self) -> dict[str, Float32]:
        """The matrices of `annotate.second_look.network.GraphNetwork`: biases are the last rows."""
        rounds = np.stack([_matrix(layer) for layer in self.rounds])
        return {"enter": _matrix(self.enter), "rounds": rounds, "leave": _matrix(self.leave)}


def _matrix(layer: nn.Module) -> Float32:
    weight, bias = (value.detach().numpy() for value in layer.parameters())
    return np.vstack([weight.T, bias[None]])


class Joined:
    """The supervoxels of several frames, one after the other, and which of them share messages."""

    def __init__(self, frames: Sequence[Rows]) -> None:
        starts = np.cumsum([0, *(len(frame.described) for frame in frames)])
        patches = np.cumsum([0, *(frame.patch.max() + 1 for frame in frames)])
        edges = np.concatenate([frame.edges + start for frame, start in zip(frames, starts, strict=False)])
        self._a, self._b = torch.tensor(np.concatenate([edges, edges[:, ::-1]]).T.copy()).long()
        patch = np.concatenate([frame.patch + start for frame, start in zip(frames, patches, strict=False)])
        number = np.repeat(np.arange(len(frames)), np.diff(starts))
        sizes = np.concatenate([frame.pixels.sum(axis=1) for frame in frames])
        self._sizes = torch.tensor(sizes[:, None], dtype=torch.float32)
        self._touching = torch.bincount(self._a, minlength=int(starts[-1]))[:, None].clamp(min=1)
        self._groups = [torch.tensor(patch).long(), torch.tensor(number).long()]
        self._totals = [torch.bincount(ids, self._sizes[:, 0])[:, None] for ids in self._groups]

    def means(self, hidden: torch.Tensor) -> list[torch.Tensor]:
        """Means (n, H) of hidden values (n, H): over each one's neighbours, its patch, its frame."""
        means = [torch.zeros_like(hidden).index_add_(0, self._a, hidden[self._b]) / self._touching]
        for ids, total in zip(self._groups, self._totals, strict=True):
            summed = torch.zeros(len(total), hidden.shape[1]).index_add_(0, ids, hidden * self._sizes)
            means.append((summed / total)[ids])
        return means


class Figures(NamedTuple):
    """Scores of the network on held-out supervoxels, of pixels: mean recall over parts, the person's IoU."""

    recall: float
    person_iou: float


def trained(
    frames: Sequence[Rows], held_out: Sequence[Rows], seed: int, advance: Callable[[int], None]
) -> tuple[dict[str, Float32], Figures]:
    """Arrays of `annotate.second_look.network.GraphNetwork`, by seed and frames alone (on one thread).

    advance: called with 1 after each of `EPOCHS`; the figures are those of the last. Raises CloudError where
    there are no frames to train on or to hold out.
    """
    if not frames or not held_out:
        raise CloudError("no frame of these recordings shows a person whose suit can be read; record more")
    every = np.concatenate([frame.described for frame in frames])
    middle, spread = every.mean(axis=0), every.std(axis=0) + np.float32(1e-3)
    torch.manual_seed(seed)
    rng, network = np.random.default_rng(seed), Graph(len(middle))
    steps = max(1, len(frames) // BATCH)
    optimizer = torch.optim.AdamW(network.parameters(), RATE, weight_decay=DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, EPOCHS * steps)

    def scores(batch: Sequence[Rows]) -> torch.Tensor:
        x = (np.concatenate([frame.described for frame in batch]) - middle) / spread
        found: torch.Tensor = network(torch.tensor(x), Joined(batch))
        return found

    for _ in range(EPOCHS):
        network.train()
        order = rng.permutation(len(frames))
        for step in range(steps):
            batch = [frames[i] for i in order[step * BATCH : (step + 1) * BATCH]]
            batch = [frame.mirrored() if rng.random() < 0.5 else frame for frame in batch]
            optimizer.zero_grad()
            _loss(scores(batch), batch).backward()  # type: ignore[no-untyped-call]
            nn.utils.clip_grad_norm_(network.parameters(), CLIP)
            optimizer.step()
            schedule.step()
        advance(1)
    network.eval()
    with torch.no_grad():
        figures = _figures([scores([frame]).numpy() for frame in held_out], held_out)
    return {"middle": middle, "spread": spread, **network.arrays()}, figures


def _loss(scores: torch.Tensor, frames: Sequence[Rows]) -> torch.Tensor:
    """Mean cross entropy over pixels of known class."""
    pixels = torch.tensor(np.concatenate([frame.pixels[:, :CLASSES] for frame in frames]))
    return -(log_softmax(scores, 1) * pixels * torch.tensor(WORTH)).sum() / pixels.sum()


def _figures(scores: Sequence[Float32], frames: Sequence[Rows]) -> Figures:
    pixels = np.concatenate([frame.pixels[:, :CLASSES] for frame in frames])
    table = np.zeros((CLASSES, CLASSES))
    np.add.at(table, np.concatenate(scores).argmax(axis=1), pixels)
    recall = (table.diagonal() / np.maximum(table.sum(axis=0), 1))[1:].mean()
    return Figures(float(recall), float(table[1:, 1:].sum() / max(table.sum() - table[0, 0], 1)))

"""A training small enough for tests, here or in processes forked from one that has imported torch."""

import os
from multiprocessing import active_children
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import torch

from eval.architecture.compact import CompactConfig
from eval.training.body_targets import FACING, POSTURE, no_targets
from eval.training.crops import Crops
from eval.training.plan import ModernRecipe, Plan
from eval.training.processes import ProcessGroup
from eval.training.train import Data, Watch, train
from sensors.errors import CloudError
from tests.helpers.forking import FORKING

PLAN = Plan(CompactConfig((4, 6, 6), 1), ModernRecipe(batch=2), epochs=3, seed=4)


def small_crops(n: int = 7, side: int = 32) -> Crops:
    """Squares of two parts, one near and one far, easily learnt; facing and posture known, joints not."""
    parts = np.zeros((n, side, side), np.uint8)
    depth = np.zeros(parts.shape, np.uint16)
    rows = [no_targets() for _ in range(n)]
    for i, row in enumerate(rows):
        parts[i, 4:28, 4 + i % 3 : 28] = 2
        parts[i, 4:14, 4 + i % 3 : 28] = 1
        row[FACING], row[POSTURE] = (np.cos(i), np.sin(i)), i % 6
    depth[parts == 1], depth[parts == 2] = 20_000, 45_000
    return Crops.of(zip(depth, parts, rows, strict=True))


CROPS = small_crops()


def begin(out: Path, **environment: str) -> BaseProcess:
    """Start the training in another process, and return that."""
    process = FORKING.Process(target=_run, args=(out, environment))
    process.start()
    return process


def begin_and_lose(out: Path, said: Path) -> BaseProcess:
    """Start it with a worker that is killed; the error's text goes to a file."""
    process = FORKING.Process(target=_lose, args=(out, said))
    process.start()
    return process


def _lose(out: Path, said: Path) -> None:
    def lose(_: int) -> None:
        for child in active_children():
            child.kill()

    try:
        with ProcessGroup.join() as group:
            train(Data(CROPS, workers=1), out, PLAN, group, Watch(lose))
    except CloudError as error:
        said.write_text(str(error))
    os._exit(0)


def _run(out: Path, environment: dict[str, str]) -> None:
    os.environ.update(environment)
    torch.set_num_threads(1)
    with ProcessGroup.join() as group:
        train(Data(CROPS, CROPS), out, PLAN, group, Watch(checkpoint_s=0.0))

"""Processes whose time and memory are measured: ``python -m tools.load.probes WHAT OUT.json ARGUMENTS``.

WHAT is ``command`` (any of annotate-cloud), ``evaluate`` or ``train``. Where a run stands, and what it has
taken by then, goes to OUT.json at its end.
"""

import json
import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np

import cli.console
import eval.compare.compare
import eval.compare.pairs
from cli.main import main
from eval.training.crops import Crops, load_crops
from tools.load.material import SHARD

TICKS = os.sysconf("SC_CLK_TCK")
EVERY_S = 0.2
STEPS = 8
"""Steps of a training that are measured at either end of an epoch, the first two left out."""


@dataclass(frozen=True)
class Sample:
    """A moment of a run: items done, processor seconds of all its processes, memory of the largest.

    own_mb: what the system cannot take back (anonymous and shared); resident_mb: with mapped files.
    """

    done: int
    cpu_s: float
    own_mb: float
    resident_mb: float


def processes(pid: int) -> Iterator[int]:
    """A process and all below it."""
    yield pid
    for children in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in children.read_text().split():
            yield from processes(int(child))


def sampled(pid: int, done: int = 0) -> Sample:
    """Where a run is. Raises OSError where one of its processes ended just now."""
    cpu, memory = 0.0, (0.0, 0.0)
    for each in processes(pid):
        fields = Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split()
        # User and system time, own and of children that have ended (proc(5), fields 14 to 17).
        cpu += sum(map(int, fields[11:15])) / TICKS
        held = dict(re.findall(r"(Rss\w+):\s+(\d+)", Path(f"/proc/{each}/status").read_text()))
        kb = {name: int(value) for name, value in held.items()}
        if kb:
            memory = max(memory, ((kb["RssAnon"] + kb["RssShmem"]) / 1000, sum(kb.values()) / 1000))
    return Sample(done, round(cpu, 2), round(memory[0], 1), round(memory[1], 1))


class Followed:
    """Samples of this process while it works."""

    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self._said = self._done = 0.0

    def advance(self, items: int) -> None:
        """So many more items are done."""
        self._done += items
        if time.monotonic() - self._said > EVERY_S:
            self._said = time.monotonic()
            with suppress(OSError):
                self.samples.append(sampled(os.getpid(), int(self._done)))

    def lines(self, what: str, total: int) -> Callable[[int], None]:
        """In the place of what a command prints of its progress."""
        return self.advance


def counted_once() -> None:
    """Shards of a long dataset show the same images again: between the first and the last thousand they are
    given the counts of those. Everything else is as ever."""
    count, pair_up = eval.compare.pairs._count_chunk, eval.compare.compare.pair_up
    seen: dict[int, list[eval.compare.pairs.Counted]] = {}
    last = 0

    def paired(*sets: Any) -> tuple[list[Any], int]:
        nonlocal last
        pairs, extra = pair_up(*sets)
        last = len(pairs) // SHARD - 4
        return pairs, extra

    def remembered(predicted: Any, truth: Any, pairs: list[Any]) -> list[eval.compare.pairs.Counted]:
        place = int(pairs[0].truth.frame_id) // SHARD
        known = seen.get(place % 4)
        if known is None or place >= last or len(pairs) != len(known):
            known = seen[place % 4] = count(predicted, truth, pairs)
        return known

    eval.compare.compare.pair_up, eval.compare.pairs._count_chunk = paired, remembered
    eval.compare.pairs.CHUNK, eval.compare.pairs.WORTH_WORKERS = SHARD, sys.maxsize


def many_crops(followed: Followed, folder: Path, images: int) -> Crops:
    """Crops of a dataset, or of more as `load_crops` would keep them: the same bytes again and again."""
    crops = load_crops([folder])
    followed.samples.append(sampled(os.getpid(), len(crops)))
    if images <= len(crops):
        return crops
    times = -(-images // len(crops))
    with TemporaryFile() as file:
        for _ in range(times):
            file.write(crops.packed.data)
        file.flush()
        packed = np.asarray(np.memmap(file, np.uint8, "r"))
    places = (np.arange(times)[:, None, None] * crops.packed.size + crops.places).reshape(-1, 3)[:images]
    wholes = np.resize(crops.wholes, (images, crops.wholes.shape[1]))
    subjects = np.resize(crops.subjects, images)
    return replace(crops, packed=packed, places=places, wholes=wholes, subjects=subjects)


def train_ends(followed: Followed, folder: Path, images: int) -> None:
    """The first steps of an epoch over so many images, and its last ones: resumed there by the checkpoint."""
    import torch

    from eval.network.compact import CompactConfig
    from eval.network.networks import build
    from eval.training.fit import resumed
    from eval.training.plan import ModernRecipe, Plan
    from eval.training.processes import ProcessGroup
    from eval.training.train import CHECKPOINT, Data, Watch, train

    torch.set_num_threads(1)
    plan, out = Plan(CompactConfig(), ModernRecipe(), epochs=1), folder.with_name(f"{images}-training")
    crops = many_crops(followed, folder, images)
    steps = len(crops) // plan.recipe.batch

    def run(last: int) -> None:
        def advance(images: int) -> None:
            nonlocal done
            done += 1
            if done in (2, STEPS):
                followed.samples.append(sampled(os.getpid(), done * images))
            if done == last:
                raise KeyboardInterrupt

        done = 0
        with ProcessGroup.join() as group, suppress(KeyboardInterrupt):
            train(Data(crops), out, plan, group, Watch(advance, checkpoint_s=0.0))

    run(STEPS)
    state = resumed(build(plan.network), plan.schedule(steps, 0.0), out / CHECKPOINT)
    state.progress.step = steps - STEPS
    state.save(out / CHECKPOINT)
    run(sys.maxsize)


def probe(what: str, out: Path, arguments: list[str]) -> None:
    """Run it and write down its samples."""
    followed = Followed()
    cli.console._lines = followed.lines
    try:
        if what == "train":
            train_ends(followed, Path(arguments[0]), int(arguments[1]))
            return
        if what == "evaluate":
            counted_once()
        sys.argv[1:] = [*(["evaluate"] if what == "evaluate" else []), *arguments]
        main()
    finally:
        with suppress(OSError):
            followed.samples.append(sampled(os.getpid(), int(followed._done)))
        out.write_text(json.dumps([asdict(sample) for sample in followed.samples]))


if __name__ == "__main__":
    probe(sys.argv[1], Path(sys.argv[2]), sys.argv[3:])

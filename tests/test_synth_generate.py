"""Generation: the same bytes for all workers, resumed after any accident, on processes or a cluster."""

import json
import os
import signal
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace

import pytest

from annotate.labelset.dataset import validate
from sensors.errors import CloudError, ExistsError
from synth.images.generate import Order, generate, make_shard
from synth.images.presets import PRESETS
from synth.images.workers import Workers, processes

SHARD = 8
"""Images a shard: few, so that a test has several."""


def order(count=20, seed=1, shard_frames=SHARD):
    return Order(PRESETS["sitting-train"], count, seed, shard_frames)


def run(folder, wanted, parallel=1):
    told = []
    with ThreadPoolExecutor(parallel) as pool:
        made = generate(wanted, folder, Workers(pool, parallel), told.append)
    assert sum(told) == wanted.count
    return made


def contents(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_the_bytes_do_not_depend_on_the_workers(tmp_path):
    one, three = run(tmp_path / "one", order()), run(tmp_path / "three", order(), 3)
    assert contents(tmp_path / "one") == contents(tmp_path / "three")
    assert one.images == three.images == 20 and len(one.dataset.shards) == 3
    assert [entry.frame_id for entry in one.dataset.entries()] == [f"{i:08d}" for i in range(20)]
    assert validate(one.dataset) == []
    manifest = json.loads((tmp_path / "one" / "dataset.json").read_text())
    assert (manifest["preset"], manifest["images"], manifest["seed"]) == ("sitting-train", 20, 1)
    assert {"annotate-cloud", "numpy"} <= manifest["versions"].keys()
    assert contents(tmp_path / "one").keys() >= {"dataset.json", "index.html", "shard-000002.tar"}
    assert run(tmp_path / "other", order(seed=2)).dataset.shards != one.dataset.shards


def test_a_longer_run_begins_with_the_shorter_one(tmp_path):
    short, long = run(tmp_path / "short", order(16)), run(tmp_path / "long", order(24))
    assert short.dataset.shards == long.dataset.shards[:2]


def test_a_broken_run_goes_on_and_ends_with_the_same_bytes(tmp_path):
    run(tmp_path / "whole", order())
    run(tmp_path / "broken", order())
    for name in ("dataset.json", "index.html", "shard-000001.tar"):
        (tmp_path / "broken" / name).unlink()
    assert run(tmp_path / "broken", order()).images == SHARD
    assert contents(tmp_path / "whole") == contents(tmp_path / "broken")
    assert run(tmp_path / "broken", order()).images == 0


@pytest.mark.parametrize(
    "other", [order(seed=2), order(21), replace(order(), preset=replace(PRESETS["sitting-train"], cut=0.5))]
)
def test_another_order_is_never_mixed_in(tmp_path, other):
    run(tmp_path / "a", order(8))
    before = contents(tmp_path / "a")
    with pytest.raises(ExistsError, match="holds another dataset"):
        run(tmp_path / "a", other)
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "mine.txt").write_text("mine")
    with pytest.raises(ExistsError):
        run(tmp_path / "b", other)
    assert contents(tmp_path / "a") == before


@pytest.mark.parametrize(("count", "seed"), [(0, 0), (-3, 0), (2_000_000_000, 0), (1, -1), (1, 2**63)])
def test_impossible_orders_are_refused(count, seed):
    with pytest.raises(CloudError, match="impossible"):
        order(count, seed)


class Broken(Executor):
    """Makes two shards, then fails as a full disk or a dying worker would."""

    def __init__(self):
        self.made = 0

    def submit(self, function, *args):
        future = Future()
        self.made += 1
        if self.made <= 2:
            future.set_result(function(*args))
        else:
            future.set_exception(OSError(28, "No space left on device"))
        return future


def test_a_failure_leaves_whole_shards_alone(tmp_path):
    with pytest.raises(OSError, match="No space"):
        generate(order(24), tmp_path / "d", Workers(Broken(), 1), lambda n: None)
    names = set(contents(tmp_path / "d"))
    assert names == {"order.json", "shard-000000.tar", "shard-000001.tar"}
    run(tmp_path / "d", order(24))
    run(tmp_path / "whole", order(24))
    assert contents(tmp_path / "d") == contents(tmp_path / "whole")


def test_a_worker_of_other_versions_is_refused():
    with pytest.raises(CloudError, match="same versions"):
        make_shard(replace(order(), versions={"numpy": "0.1"}), 0)


def test_processes_give_the_same_bytes_and_survive_a_killed_one(tmp_path):
    with pytest.raises(CloudError, match="was killed"), processes(2) as workers:
        generate(order(), tmp_path / "pool", workers, lambda n: None)
        workers.executor.submit(_die).result()
    run(tmp_path / "here", order())
    assert contents(tmp_path / "pool") == contents(tmp_path / "here")


def _die():
    os.kill(os.getpid(), signal.SIGKILL)

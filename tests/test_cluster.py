"""A real scheduler and real workers on loopback: the bytes of one machine, even if a worker is killed.

The tests follow each other: every one leaves fewer workers.
"""

import json
import os
import shutil
import signal
import socket
import threading
import time

import pytest

from annotate.labelset.label_set import MANIFEST, LabelSet
from eval.compare.results import load_result
from sensors.errors import CloudError
from synth.images.generate import generate
from synth.images.workers import cluster
from synth.rig.simulate import suit_path, truth_path
from tests.conftest import assert_refused, tree
from tests.test_synth_generate import SHARD, contents, order, run


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def stop(process):
    process.kill()
    process.join(10)


@pytest.fixture(scope="module")
def dask():
    """(address, scheduler, workers): one scheduler, three workers of one thread, all on loopback."""
    pytest.importorskip("distributed", reason="distributed is missing; install the extra 'cluster'")
    from tests.helpers.dask_node import begin

    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    scheduler = begin("scheduler", f"--host 127.0.0.1 --port {port} --no-dashboard --no-show")
    worker = f"{address} --nthreads 1 --no-dashboard --no-nanny --host 127.0.0.1"
    running = [scheduler, *(begin("worker", worker) for _ in range(3))]
    yield address, scheduler, running[1:]
    for process in running:
        stop(process)


def joined(address, number):
    """The cluster's context, once so many workers have come."""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        with cluster(address) as hands:
            if hands.parallel >= number:
                return cluster(address)
        time.sleep(0.1)
    raise AssertionError(f"{number} workers did not come")


def test_a_cluster_that_loses_a_worker_gives_the_local_bytes(tmp_path, dask):
    address, _, workers = dask
    told = []

    def kill_one(images):
        told.append(images)
        if sum(told) == 3 * SHARD:
            stop(workers[0])

    with joined(address, 3) as hands:
        generate(order(120), tmp_path / "cluster", hands, kill_one)
    assert workers[0].exitcode is not None and sum(told) == 120
    run(tmp_path / "here", order(120))
    assert contents(tmp_path / "cluster") == contents(tmp_path / "here")


@pytest.fixture
def ward(rig_session, tmp_path):
    """A folder of two sessions with their truth."""
    folder = tmp_path / "ward"
    folder.mkdir()
    for name in ("monday", "tuesday"):
        shutil.copy(rig_session, folder / f"{name}.mcap")
        shutil.copytree(truth_path(rig_session), folder / f"{name}.truth")
    return folder


def assert_alike(one, other):
    """Label sets of the same bytes, except the names of their recordings."""
    sets = [LabelSet.open(path) for path in (one, other)]
    for labels in sets:
        assert labels.info.pop("recording")["name"] == f"{labels.path.name}.mcap"
    assert sets[0].info == sets[1].info
    bytes_ = [
        {name: hash_ for name, hash_ in tree(path).items() if name != MANIFEST} for path in (one, other)
    ]
    assert bytes_[0] == bytes_[1]


def kill_who_labels(labels):
    """Kill the process that has this label set open, once it has written a frame."""
    while not list(labels.glob("frames/*.json")):
        time.sleep(0.01)
    os.kill(json.loads((labels / "claim.json").read_text())["process"], signal.SIGKILL)


def test_a_folder_of_sessions_is_labelled_and_measured_though_a_worker_is_killed(
    ward, tmp_path, dask, annotate_cloud, rig_session, rig_labels
):
    address, _, workers = dask
    labels, results, at = tmp_path / "labels", tmp_path / "results", ("--scheduler", address, "--json")
    killer = threading.Thread(target=kill_who_labels, args=(labels / "monday",))
    killer.start()
    done = annotate_cloud("label", ward, "--suit", suit_path(rig_session), "--out", labels, *at)
    killer.join()
    assert done.code == 0 and sum(worker.exitcode is not None for worker in workers) == 2, done.err
    assert done.result["sessions"] == {name: {"frames": 3, "failed": 0} for name in ("monday", "tuesday")}
    assert_alike(labels / "monday", labels / "tuesday")
    assert tree(labels / "monday" / "frames") == tree(rig_labels.path / "frames")
    measured = annotate_cloud("evaluate", labels, ward, "--out", results, *at).result["sessions"]
    assert measured["monday"]["mean_recall"] == measured["tuesday"]["mean_recall"] > 0.9
    kept = {path.name: path.read_bytes() for path in results.iterdir()}
    assert annotate_cloud("evaluate", labels, ward, "--out", results, "--json").result["sessions"] == measured
    assert {path.name: path.read_bytes() for path in results.iterdir()} == kept
    assert load_result(results / "monday.npz").title == "labels: monday"


def test_a_scheduler_that_dies_is_one_line_and_the_run_goes_on_elsewhere(tmp_path, dask):
    address, scheduler, _ = dask
    with pytest.raises(CloudError, match="was lost") as caught, joined(address, 1) as hands:
        generate(order(120), tmp_path / "d", hands, lambda images: images and stop(scheduler))
    assert "\n" not in str(caught.value)
    assert not list((tmp_path / "d").glob(".*"))
    assert 0 < run(tmp_path / "d", order(120)).images < 120


def test_a_folder_without_a_scheduler_is_done_here_and_what_fails_is_named(ward, tmp_path, annotate_cloud):
    (ward / "wednesday.mcap").write_bytes(b"no session")
    done = annotate_cloud("predict", ward, "--out", tmp_path / "out", "--json")
    assert done.code == 3 and set(done.result["sessions"]) == {"monday", "tuesday"}
    assert set(done.result["failed"]) == {"wednesday"} and "wednesday" in done.err
    assert_alike(tmp_path / "out" / "monday", tmp_path / "out" / "tuesday")
    for name in ("monday", "tuesday"):
        shutil.rmtree(ward / f"{name}.truth")
    assert_refused(annotate_cloud("evaluate", tmp_path / "out", ward), "monday has no truth")
    assert (
        annotate_cloud(
            "label", ward / "monday.mcap", "--out", tmp_path / "l", "--scheduler", "tcp://a:1"
        ).code
        == 2
    )


def test_a_dead_scheduler_is_one_line(monkeypatch):
    pytest.importorskip("distributed", reason="distributed is missing; install the extra 'cluster'")
    monkeypatch.setattr("synth.images.workers.CONNECT_SECONDS", 1)
    for address in (f"tcp://127.0.0.1:{free_port()}", "nonsense://:::"):
        with pytest.raises(CloudError, match="does not answer") as caught, cluster(address):
            pass
        assert "\n" not in str(caught.value)

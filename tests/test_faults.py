"""Kills, full disks, clocks that jump, two writers, lost workers: results stay, and runs resume."""

import os
import shutil
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from conftest import assert_refused, largest_file, tree

from annotate.correction.correction import Correction
from annotate.frame_labels import FrameLabels
from annotate.label_recording import SuitLabeller, label_source
from annotate.labelset.atomic_folder import appearing, claimed_to_replace, moved_aside
from annotate.labelset.claim import CLAIM, Claim, ClaimedError
from annotate.labelset.journal import JOURNAL
from annotate.labelset.label_set import MANIFEST, LabelSet, validate
from annotate.suit.palette import DEFAULT_SUIT
from sensors.errors import CloudError, ExistsError
from sensors.files.atomic import sweep, temporary_of
from sensors.rig.camera import Intrinsics
from sensors.session.reader import Session
from synth.images.generate import Order, generate
from synth.images.presets import PRESETS
from synth.images.workers import Workers
from synth.rig.simulate import suit_path

ORDER = Order(PRESETS["sitting-test"], 12, 3, shard_frames=4)


def made(out: Path) -> None:
    """Make or continue the dataset of ORDER."""
    with ThreadPoolExecutor(1) as pool:
        generate(ORDER, out, Workers(pool, 1), lambda n: None)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> dict[str, str]:
    """Return the dataset of an uninterrupted run."""
    out = tmp_path_factory.mktemp("whole") / "d"
    made(out)
    return tree(out)


def partial_of(folder: Path) -> list[str]:
    return [name for name in tree(folder) if name.endswith(".partial")]


KILLED = """
import os, signal, sys
from pathlib import Path
from cli.main import main
from test_faults import made

def ends(by, event, number, run):
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if by == signal.SIGINT:
        for stream in (1, 2):
            os.dup2(os.open(f"{folder}/said.{stream}", os.O_CREAT | os.O_WRONLY), stream)
    left = number
    def look(name, arguments):
        nonlocal left
        if name == event and folder in str(arguments):
            left -= 1
            if not left:
                os.kill(os.getpid(), by)
    sys.addaudithook(look)
    try:
        run()
    except SystemExit as end:
        sys.stdout.flush(), sys.stderr.flush()
        os._exit(end.code)
    finally:
        os._exit(99)

def command(*arguments):
    sys.argv = ["annotate-cloud", *arguments]
    main()

def label(name):
    command("label", session, "--suit", suit, "--out", f"{folder}/{name}", "--json")

folder, session, suit, labels = sys.argv[1:]
for by, event, number, run in (
    (signal.SIGINT, "os.rename", 9, lambda: label("interrupted")),
    (signal.SIGKILL, "os.rename", 9, lambda: label("labels")),
    (signal.SIGKILL, "os.rename", 9, lambda: command("predict", labels, "--out", f"{folder}/predicted")),
    (signal.SIGKILL, "open", 5, lambda: command("export", labels, f"{folder}/pairs", "--format", "pairs")),
    (signal.SIGKILL, "os.rename", 3, lambda: made(Path(f"{folder}/dataset"))),
    (signal.SIGKILL, "os.rename", 1, lambda: command("simulate", f"{folder}/s.mcap", "--frames", "1")),
):
    print(ends(by, event, number, run), flush=True)
"""


@pytest.fixture(scope="module")
def killed(tmp_path_factory, rig_session, rig_labels) -> Path:
    """Return a folder with the remains of killed verbs and of an interrupted verb.

    Each ended at the worst moment, with a file written and not yet named.
    """
    folder = tmp_path_factory.mktemp("killed")
    command = [sys.executable, "-c", KILLED, folder, rig_session, suit_path(rig_session), rig_labels.path]
    here = Path(__file__).parent
    environment = {**os.environ, "PYTHONPATH": f"{here.parent}:{here}"}
    # A shell lets what it starts in the background ignore Ctrl-C, and all its children.
    heeding = partial(signal.signal, signal.SIGINT, signal.SIG_DFL)
    done = subprocess.run(
        command, capture_output=True, text=True, env=environment, check=True, timeout=300, preexec_fn=heeding
    )
    assert done.stdout.split() == ["130", *["-9"] * 5], done
    assert partial_of(folder), "killed while it wrote"
    return folder


def test_ctrl_c_is_said_and_the_same_command_gives_the_same_labels(
    annotate_cloud, killed, rig_session, rig_labels
):
    out = killed / "interrupted"
    assert (killed / "said.1").read_text() == ""
    remarks = (killed / "said.2").read_text()
    assert remarks.splitlines()[-1].startswith("annotate-cloud: interrupted")
    assert "Traceback" not in remarks
    begun = LabelSet.open(out)
    assert 1 <= len(begun) < len(rig_labels) and not validate(begun)
    assert all(frame.parts.any() for frame in begun)
    assert not partial_of(out)
    assert annotate_cloud("label", rig_session, "--suit", suit_path(rig_session), "--out", out).code == 0
    assert tree(out) == tree(rig_labels.path)


@pytest.mark.parametrize("verb", ["label", "predict", "export", "generate"])
def test_a_killed_run_continues_to_the_same_bytes(
    annotate_cloud, killed, tmp_path, rig_session, rig_labels, whole, verb
):
    name = {"label": "labels", "predict": "predicted", "export": "pairs", "generate": "dataset"}[verb]

    def run(out: Path) -> None:
        labelling = ("label", rig_session, "--suit", suit_path(rig_session), "--out", out)
        commands = {
            "label": labelling,
            "predict": ("predict", rig_labels.path, "--out", out),
            "export": ("export", rig_labels.path, out, "--format", "pairs"),
        }
        if verb == "generate":
            made(out)
        else:
            assert annotate_cloud(*commands[verb]).code == 0

    out = killed / name
    if verb == "export":
        assert not out.exists() and list(killed.glob(".pairs.*.partial"))
    elif verb == "generate":
        assert partial_of(out)
        assert {name: hash_ for name, hash_ in tree(out).items() if name in whole}.items() <= whole.items()
    else:
        assert not [problem for problem in validate(LabelSet.open(out)) if "holds no frames" not in problem]
    run(out)
    run(tmp_path / "whole")
    assert tree(out) == tree(tmp_path / "whole")
    assert verb != "export" or not list(killed.glob(".pairs.*.partial"))


def test_a_killed_simulate_is_refused_and_made_anew(annotate_cloud, killed, shot_before):
    command = ("simulate", killed / "s.mcap", "--frames", 1)
    assert not (killed / "s.mcap").exists()
    assert_refused(annotate_cloud(*command), "--overwrite")
    assert annotate_cloud(*command, "--overwrite").code == 0
    assert not list(killed.glob("s.*partial"))


@pytest.mark.parametrize("removed", ["marker", "frames"])
def test_a_result_that_replaces_another_is_never_half_of_one(tmp_path, monkeypatch, removed):
    """A kill during the removal of the old result leaves a whole one, which the next run replaces."""
    out = tmp_path / "out"

    def write(text: str) -> None:
        with appearing(out, "marker", overwrite=True) as folder:
            for name in ("marker", "frames"):
                (folder / name).write_text(text)

    def killed(path: Path, **_) -> None:
        if path.exists():
            (path / removed).unlink()
            raise KeyboardInterrupt

    write("old")
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(shutil, "rmtree", killed)
        write("new")
    assert len({(out / name).read_text() for name in ("marker", "frames")}) == 1
    write("newer")
    assert (out / "marker").read_text() == "newer"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_set_that_is_being_replaced_is_not_corrected(tmp_path):
    out = tmp_path / "labels"

    def written(folder: Path) -> None:
        labels = LabelSet.create(folder, Intrinsics(8, 8, 8.0, 8.0, 4.0, 4.0), {"source": "x"})
        depth_mm = np.full((8, 8), 1000, np.uint16)
        labels.write(FrameLabels("000000", depth_mm, np.ones((8, 8), np.uint8)))

    written(out)
    with appearing(out, MANIFEST, overwrite=True) as folder:
        written(folder)
        with pytest.raises(ClaimedError):
            Correction.open(out, "ann")
    with Correction.open(out, "ann") as correction:
        with pytest.raises(ClaimedError), claimed_to_replace(out, MANIFEST):
            pass
        correction.edit("000000").paint(np.arange(8), 2)
    with pytest.raises(ExistsError, match="corrections"), appearing(out, MANIFEST, overwrite=True):
        pass
    assert (out / JOURNAL).is_file()


def test_a_result_that_cannot_take_its_place_restores_the_old_one(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "marker").write_text("old")
    with pytest.raises(OSError, match="full"), moved_aside(out):
        raise OSError("the disk is full")
    assert (out / "marker").read_text() == "old"
    assert list(tmp_path.iterdir()) == [out]


def test_a_released_claim_leaves_later_claims_on_a_replaced_folder(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    first = Claim.take(out, "ann")
    out.replace(tmp_path / "aside")
    out.mkdir()
    with Claim.take(out, "ben"):
        first.release()
        with pytest.raises(ClaimedError, match="ben"):
            Claim.take(out, "cid")


def test_the_living_keep_what_they_are_making(tmp_path):
    mine, parent_s = temporary_of(tmp_path / "x"), tmp_path / f".x.0a1b2c3d.{os.getppid()}.partial"
    # The last one's process is dead, and had the number that this one has now.
    dead = [tmp_path / f".x.{ending}.partial" for ending in (2**22 + 1, f"0a1b2c3d.{os.getpid()}")]
    for path in (mine, parent_s, *dead):
        path.mkdir()
    sweep(tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted([mine, parent_s])


def test_a_full_disk_leaves_whole_shards_and_generate_goes_on(tmp_path, whole):
    out = tmp_path / "d"
    with largest_file(5_000), pytest.raises(OSError, match="File too large"):
        made(out)
    assert list(tree(out)) == ["order.json"]
    made(out)
    assert tree(out) == whole


def test_a_full_disk_is_one_line_of_train_and_it_goes_on(tmp_path):
    tiny = pytest.importorskip("tests.helpers.tiny_training", reason="training needs torch")
    from eval.training.processes import ProcessGroup
    from eval.training.train import Data, Watch, train

    def trained(out: Path) -> None:
        with ProcessGroup.join() as group:
            train(Data(tiny.CROPS), out, tiny.PLAN, group, Watch(checkpoint_s=0.0))

    with largest_file(4_000), pytest.raises(CloudError, match=r"cannot be written .*free some space"):
        trained(tmp_path / "t")
    assert not [name for name in tree(tmp_path) if "checkpoint" in name or "partial" in name]
    trained(tmp_path / "t")
    assert (tmp_path / "t" / "history.json").is_file()
    with Claim.take(tmp_path / "t", "ann"), pytest.raises(ClaimedError, match="written by ann"):
        trained(tmp_path / "t")


def test_two_labels_of_one_set_take_turns(annotate_cloud, tmp_path, rig_session, rig_labels):
    out, seen = tmp_path / "l", []

    def meanwhile(n: int) -> None:
        for overwrite in ([], ["--overwrite"]):
            second = annotate_cloud(
                "label", rig_session, "--suit", suit_path(rig_session), "--out", out, *overwrite
            )
            assert_refused(second, f"{out} is being written by", f"process {os.getpid()}")
        with pytest.raises(ClaimedError, match="being written"):
            Correction.open(out)
        seen.append(len(Correction.open(out, read_only=True).labels))

    label_source(Session(rig_session), SuitLabeller(DEFAULT_SUIT), out, meanwhile)
    assert len(seen) == 3
    assert all(on_disk >= told for told, on_disk in enumerate(seen, 1))
    assert tree(out) == tree(rig_labels.path)


def test_nothing_is_written_to_a_set_that_is_being_corrected(
    annotate_cloud, tmp_path, rig_session, rig_labels
):
    labels = Path(shutil.copytree(rig_labels.path, tmp_path / "labels"))
    with Correction.open(labels, "ann"):
        before = tree(labels)
        for command in (
            ("label", rig_session, "--suit", suit_path(rig_session), "--out", labels),
            ("predict", rig_session, "--overwrite", "--out", labels),
            ("import", tmp_path / "pairs", labels, "--overwrite"),
        ):
            if command[0] == "import":
                assert annotate_cloud("export", labels, tmp_path / "pairs", "--format", "pairs").code == 0
            assert_refused(annotate_cloud(*command), f"{labels} is being written by ann@")
        assert tree(labels) == before


def test_a_claim_of_a_dead_process_or_a_failed_run_is_free(tmp_path, rig_session, rig_labels):
    labels = Path(shutil.copytree(rig_labels.path, tmp_path / "labels"))
    (labels / CLAIM).write_text('{"who": "ann"}')
    labeller = SuitLabeller(DEFAULT_SUIT)
    label_source(Session(rig_session), labeller, labels, lambda n: None)
    assert tree(labels) == tree(rig_labels.path)

    def fails(n: int) -> None:
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space"):
        label_source(Session(rig_session), labeller, tmp_path / "l", fails)
    Claim.take(tmp_path / "l", "bob").release()


def test_two_generates_of_one_dataset_take_turns(tmp_path, whole):
    out, refused = tmp_path / "d", []

    def meanwhile(n: int) -> None:
        with pytest.raises(ClaimedError) as error:
            made(out)
        refused.append(error)

    with ThreadPoolExecutor(1) as pool:
        generate(ORDER, out, Workers(pool, 1), meanwhile)
    assert refused and tree(out) == whole

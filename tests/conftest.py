"""Shared fixtures: real recordings if available, a small virtual recording, and the command."""

import gc
import hashlib
import json
import os
import pickle
import resource
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fcntl import LOCK_EX, flock
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

import annotate.correction.select
import annotate.onnx_session
import synth.rig.film
import synth.rig.virtual_rig
from annotate.array_types import Float32, UInt8
from annotate.cloud.supervoxels import Supervoxels, supervoxels
from annotate.label_recording import SuitLabeller, label_source
from annotate.labelset.label_set import LabelSet
from annotate.person.detection import finder_network, verifier
from annotate.segmentation import suit_network
from annotate.suit.palette import DEFAULT_SUIT
from cli.main import main
from eval.network import onnx_network
from sensors.rig.frame import RigFrame
from sensors.session.reader import Session
from sensors.session.writer import SessionWriter
from synth.rig.simulate import simulate
from synth.rig.virtual_rig import RigOptions, VirtualRig

settings.register_profile("tests", max_examples=40, deadline=None)
settings.load_profile("tests")

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the pages of the documentation first, because they take longest."""
    items.sort(key=lambda item: item.path.name != "test_docs.py")


def pytest_collection_finish() -> None:
    """Leave the modules and the tests out of garbage collections, a second each."""
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def without_flushing() -> Iterator[None]:
    """Leave writing to the disk to the system, because no test cuts the power."""
    with pytest.MonkeyPatch.context() as patched:
        for name in ("fsync", "fdatasync"):
            patched.setattr(os, name, lambda file: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def networks_once() -> Iterator[None]:
    """Prepare each network for computation once, however often tests load its file."""
    kept = lru_cache(maxsize=8)(annotate.onnx_session.onnx_session)
    with pytest.MonkeyPatch.context() as patched:
        for module in (finder_network, verifier, suit_network, onnx_network):
            patched.setattr(module, "onnx_session", kept)
        yield


@pytest.fixture(scope="session", autouse=True)
def supervoxels_once() -> Iterator[None]:
    """Compute the supervoxels of a frame once, because many windows open the same frames."""
    found: dict[tuple[object, ...], Supervoxels] = {}

    def kept(points_m: Float32, colors_rgb: UInt8, **options: float) -> Supervoxels:
        digests = (hashlib.sha256(array.tobytes()).digest() for array in (points_m, colors_rgb))
        key = (*digests, *sorted(options.items()))
        if key not in found:
            found[key] = supervoxels(points_m, colors_rgb, **options)
        return found[key]

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(annotate.correction.select, "supervoxels", kept)
        yield


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of real recordings beside the checkout; skip without the folder."""
    if not SHARED_DATA.is_dir():
        pytest.skip("no real recordings: ../shared/data is absent")
    return SHARED_DATA


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return a file for all processes of a run of the tests; the first process makes the file."""
    base = factory.getbasetemp()
    path = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "made-once" / name
    path.parent.mkdir(exist_ok=True)
    with path.with_name(f"{name}.lock").open("w") as lock:
        flock(lock, LOCK_EX)
        done = path.with_name(f"{name}.done")
        if not done.exists():
            make(path)
            done.touch()
    return path


@pytest.fixture(scope="session")
def rig_session(tmp_path_factory) -> Path:
    """Return a clean recording of the virtual rig, 3 frames of 2 people, beside its truth and suit."""

    def record(path: Path) -> None:
        rig = VirtualRig(3, 2, "clean", 5)
        shot = list(rig.with_truth())
        path.with_suffix(".shot").write_bytes(pickle.dumps(shot))
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(rig, "with_truth", lambda: iter(shot))
            simulate(rig, path, lambda n: None)

    return made_once(tmp_path_factory, "session.mcap", record)


@pytest.fixture
def shot_before(rig_session, monkeypatch) -> None:
    """Let virtual rigs show the frames of ``rig_session`` at once, for tests of files."""
    shot = pickle.loads(rig_session.with_suffix(".shot").read_bytes())
    monkeypatch.setattr(VirtualRig, "with_truth", lambda rig: iter(shot[: rig.frames]))


@pytest.fixture
def draft_rigs(monkeypatch) -> None:
    """Let commands simulate rigs with small colour images, in half the time."""
    for module in (synth.rig.virtual_rig, synth.rig.film):
        monkeypatch.setattr(module, "RigOptions", partial(RigOptions, draft=True))


@pytest.fixture(scope="session")
def rig_labels(rig_session, tmp_path_factory) -> LabelSet:
    """Return the labels of an uninterrupted ``label`` of ``rig_session``."""

    def label(out: Path) -> None:
        label_source(Session(rig_session), SuitLabeller(DEFAULT_SUIT), out, lambda n: None)

    return LabelSet.open(made_once(tmp_path_factory, "labels", label))


@pytest.fixture(scope="session")
def display() -> str:
    """Return the screen of the environment, or of an Xvfb that ends with this process."""
    if os.environ.get("DISPLAY"):
        return os.environ["DISPLAY"]
    if not shutil.which("Xvfb"):
        pytest.skip("no screen and no Xvfb to make one: apt install xvfb")
    reading, writing = os.pipe()
    # setpriv, and no terminate() here: Qt ends the tests' process when its screen goes first.
    command = ["setpriv", "--pdeathsig", "TERM", "Xvfb", "-displayfd", str(writing), "-screen", "0"]
    command += ["1600x1200x24", "-nolisten", "tcp"]
    os.set_inheritable(writing, True)
    silent = (os.POSIX_SPAWN_OPEN, 2, os.devnull, os.O_WRONLY, 0)
    # Popen would warn at exit, because Xvfb still runs.
    os.posix_spawnp(command[0], command, os.environ, file_actions=[silent])
    os.close(writing)
    with os.fdopen(reading) as numbers:
        os.environ["DISPLAY"] = f":{numbers.readline().strip()}"
    os.environ["QT_QPA_PLATFORM"] = "xcb"
    return os.environ["DISPLAY"]


@pytest.fixture(scope="session")
def qapp_args(display) -> list[str]:
    """Return the arguments of pytest-qt's application, which needs a screen."""
    return ["annotate-cloud"]


@dataclass(frozen=True)
class Ended:
    """Exit code and output of a command."""

    code: int
    out: str
    err: str

    @property
    def result(self) -> dict[str, Any]:
        """The JSON object on stdout."""
        assert self.out.count("\n") == 1, self.out
        value = json.loads(self.out)
        assert isinstance(value, dict)
        return value


@pytest.fixture
def annotate_cloud(monkeypatch, capsys) -> Callable[..., Ended]:
    """Return a function that runs ``annotate-cloud`` in this process, as the script does."""

    def run(*arguments: object) -> Ended:
        monkeypatch.setattr(sys, "argv", ["annotate-cloud", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as end:
            main()
        return Ended(int(end.value.code or 0), *capsys.readouterr())

    return run


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Limit files to ``size`` bytes, as on a disk that fills up during a write."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def tree(path: Path) -> dict[str, str]:
    """Return all paths below a folder: relative path -> SHA-256, "" for folders."""
    return {
        str(p.relative_to(path)): hashlib.sha256(p.read_bytes()).hexdigest() if p.is_file() else ""
        for p in sorted(path.rglob("*"))
    }


def assert_refused(done: Ended, *says: object, remarks: int = 0) -> None:
    """Assert exit 1 and one line on stderr, after ``remarks`` others, that contains the texts."""
    assert (done.code, done.out) == (1, ""), done
    lines = done.err.splitlines()
    assert len(lines) == 1 + remarks, done.err
    assert lines[-1].startswith("annotate-cloud: ")
    for said in says:
        assert str(said) in lines[-1]


def record(path: Path, source: Session, change: Callable[[RigFrame], RigFrame]) -> Path:
    """Write a recording with every frame changed."""
    with SessionWriter(path, source.calibration, source.name) as writer:
        for frame in source:
            writer.write(change(frame))
    return path

"""Every command that the documentation shows is run, page by page, on small sizes."""

import os
import re
import shlex
import shutil
from pathlib import Path

import pytest

import cli.rig_devices
import eval.learning.learn
from annotate.correction.correction import Correction
from synth.rig.simulate import suit_path, truth_path

ROOT = Path(__file__).parent.parent
PAGES = ["README.md", *(f"docs/{p.name}" for p in sorted((ROOT / "docs").glob("*.md")))]

ELSEWHERE = {
    "make": "the set-up itself: run by whoever runs these tests",
    "export": "the set-up itself",
    "pip install": "the set-up itself: what it brings is tested in test_packaging.py",
    "annotate-cloud --install-completion": "writes to the user's own files: test_cli_completion.py",
    "annotate-cloud compile": "the set-up itself: make setup runs it",
    "annotate-cloud fix": "a window: driven by the tests of the window",
    "annotate-cloud record take.mcap --rig": "asks for devices; docs/camera.md records from their twins",
    "annotate-cloud live": "asks for devices and a screen: test_live.py, test_foxglove.py",
    "podman": "a container engine, which few machines with tests have",
    "dask": "scheduler and workers: run by the tests of generating",
}
"""Lines that these tests leave to others, and to whom."""

SMALLER = (
    (r"--count \d+", "--count 8"),
    (r"--epochs \d+", "--epochs 1"),
    (r"--subjects 8", "--subjects 2"),
    (r" --difficulty normal", ""),  # the default: pages then share recordings
    (r"--scene plate( --frames \d+)?", "--scene plate --frames 12"),
    (r"--seconds \d+", "--seconds 1"),
    (r" --scheduler \S+", ""),
    (r"synth generate", "synth generate --workers 1"),
)
"""What makes a command small: what it is asked to do is the same, only less of it."""

SHARED = ("annotate-cloud simulate", "board.mcap", "mine.mcap")
"""What simulates, and recordings that are the same on every page: the same words are run once."""


def commands_of(page: str) -> list[str]:
    """The lines of a page's shell blocks, without comments and empty ones."""
    blocks = re.findall(r"^```sh\n(.*?)^```", (ROOT / page).read_text(), re.M | re.S)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    return [line.split(" #")[0].replace(".venv/bin/", "").strip() for line in lines if line.strip()]


def left_out(command: str) -> bool:
    return any(command.startswith(start) for start in ELSEWHERE)


def test_pages_hold_commands_and_every_exception_is_met():
    shown = [command for page in PAGES for command in commands_of(page)]
    assert len(shown) > 40
    assert all(command.startswith("annotate-cloud ") or left_out(command) for command in shown)
    for start in ELSEWHERE:
        assert any(command.startswith(start) for command in shown), start


def smaller(command: str, page: str) -> str:
    """The command as it is run here. A check of a calibration wants eight frames, all else four."""
    frames = 8 if any("people.mcap --check" in other for other in commands_of(page)) else 4
    for pattern, less in ((r"--frames \d+", f"--frames {frames}"), *SMALLER):
        command = re.sub(pattern, less, command)
    return command


@pytest.fixture(scope="module")
def my_folder(tmp_path_factory) -> Path:
    """A user's own images."""
    from tools.docs.material import write_image_folder

    folder = tmp_path_factory.mktemp("docs") / "my-folder"
    write_image_folder(folder)
    return folder


def prepare(page: str, folder: Path, rig_session: Path, my_folder: Path) -> None:
    """What a page takes for granted: the user's own files."""
    text = (ROOT / page).read_text()
    if "my-folder" in text:
        shutil.copytree(my_folder, folder / "my-folder")
    if "monday.mcap" in text:
        shutil.copy(suit_path(rig_session), folder / "ours.toml")
        for day in ("monday", "tuesday", "wednesday"):
            shutil.copy(rig_session, folder / f"{day}.mcap")
            shutil.copytree(truth_path(rig_session), folder / day)
    if "walk.c3d" in text:
        from tools.docs.material import write_trials

        write_trials(folder)


def accept_all_but_one(labels: Path) -> None:
    """What a page's reader did in the window."""
    with Correction.open(labels) as correction:
        for frame_id in correction.labels.frame_ids[1:]:
            correction.edit(frame_id).judge("accept")


@pytest.fixture(scope="module")
def made() -> dict[str, list[Path]]:
    """What commands on material that pages share have made, by command."""
    return {}


@pytest.mark.parametrize("page", [page for page in PAGES if any(not left_out(c) for c in commands_of(page))])
def test_the_commands_of_a_page_run_in_order(
    page, tmp_path, rig_session, my_folder, annotate_cloud, made, monkeypatch
):
    prepare(page, tmp_path, rig_session, my_folder)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli.rig_devices, "VIRTUAL_FRAMES", 3)
    for command in commands_of(page):
        if left_out(command):
            continue
        small = smaller(command, page)
        if small.startswith("annotate-cloud learn "):
            accept_all_but_one(tmp_path / shlex.split(small)[2])
            monkeypatch.setattr(os, "nice", lambda by: 0)
            monkeypatch.setattr(eval.learning.learn, "STEPS", 1)
            monkeypatch.setattr(eval.learning.learn, "ALL_STEPS", 1)
        for path in made.get(small, ()):
            (shutil.copytree if path.is_dir() else shutil.copy)(path, path.name)
        if small in made:
            continue
        before = set(tmp_path.iterdir())
        done = annotate_cloud(*shlex.split(small)[1:])
        assert done.code == 0, f"{small}: {done.err}"
        if any(name in small for name in SHARED):
            made[small] = sorted(set(tmp_path.iterdir()) - before)

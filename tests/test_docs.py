"""Every command that the documentation shows is run, page by page, on small sizes."""

import hashlib
import os
import re
import shlex
import shutil
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from conftest import tree
from typer.main import get_command

import annotate.person.alignment
import cli.rig_devices
import eval.fine_tuning.fine_tune
import eval.fine_tuning.run
import synth.images.workers
import synth.rig.film
from annotate.correction.correction import Correction
from cli.main import app
from eval.training.segmentation.augmentation import Sampling
from sensors.recording.rig_templates import REFERENCE, TEMPLATES
from sensors.session.reader import Session
from synth.images.workers import Workers
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
    "annotate-cloud benchmark": "asks for recordings of others: test_benchmark.py",
    "podman": "a container engine, which few machines with tests have",
    "dask": "scheduler and workers: run by the tests of generating",
}
"""Lines that these tests leave to others, and to whom."""

SMALLER = (
    (r"(simulate p\w+\.mcap) .*", r"\1 --frames 4 --subjects 2 --seed 6"),  # one recording for all pages
    (r"--hold-out subject-\d", "--hold-out subject-1"),
    (r"--subjects 8 --frames \d+", "--subjects 1 --frames 1"),
    (r"--scene plate( --frames \d+)?", "--scene plate --frames 12"),
    (r"--count \d+", "--count 4"),
    (r"--epochs \d+", "--epochs 1"),
    (r"--seconds \d+", "--seconds 1"),
    (r"(train-labels .*)", r"\1 --steps 1"),
    (r" --scheduler \S+", ""),
    (r"synth generate", "synth generate --workers 1"),
    (r"(train s\S+ .*)", r"\1 --network compact-small"),
)
"""What makes a command small: what it is asked to do is the same, only less of it."""
PLATE_RIG = TEMPLATES[REFERENCE]
COLOR = PLATE_RIG.calibration.color
SMALL_COLOR = replace(COLOR, width=960, height=540, fx=COLOR.fx / 2, fy=COLOR.fy / 2, cx=479.5, cy=269.5)
SMALL_RIG = replace(PLATE_RIG, calibration=replace(PLATE_RIG.calibration, color=SMALL_COLOR))
"""What sees the hole plate: a quarter of the pixels in colour."""


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


def test_every_command_is_understood_as_it_is_shown():
    """Those that are run smaller, or elsewhere, too."""
    understood = 0
    for page in PAGES:
        for command in commands_of(page):
            if not command.startswith("annotate-cloud ") or "--install-completion" in command:
                continue
            verb, words = get_command(app), shlex.split(re.split(r" [|>]", command)[0])[1:]
            context = verb.make_context("annotate-cloud", words)
            while hasattr(verb, "resolve_command"):
                name, verb, words = verb.resolve_command(context, [*context._protected_args, *context.args])
                context = verb.make_context(name, words, parent=context)
            assert context.params and not context.args, command
            understood += 1
    assert understood > 40


def smaller(command: str) -> str:
    """The command as it is run here."""
    for pattern, less in SMALLER:
        command = re.sub(pattern, less, command)
    return command


def asked(command: str) -> tuple[str, ...]:
    """A command and what it finds under the names in it: the same again would make the same."""
    there = [path for word in shlex.split(command) if (path := Path(word)).exists()]
    return command, *(
        str(tree(p)) if p.is_dir() else hashlib.sha256(p.read_bytes()).hexdigest() for p in there
    )


@pytest.fixture(scope="module")
def my_folder(tmp_path_factory, rig_session) -> Path:
    """A user's own images."""
    from tools.docs.material import write_image_folder

    folder = tmp_path_factory.mktemp("docs") / "my-folder"
    write_image_folder(folder, Session(rig_session))
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


@contextmanager
def here(count: int) -> Iterator[Workers]:
    """Makers of shards in this process: those that are processes start once, on the page about them."""
    with ThreadPoolExecutor(count) as pool:
        yield Workers(pool, count)


def copied(paths: Iterable[Path], folder: Path) -> None:
    for path in paths:
        (shutil.copytree if path.is_dir() else shutil.copy)(path, folder / path.name)


@pytest.fixture(scope="module")
def made() -> dict[tuple[str, ...], Path]:
    """Folders with what commands have made, by what was asked."""
    return {}


@pytest.mark.parametrize("page", [page for page in PAGES if any(not left_out(c) for c in commands_of(page))])
def test_the_commands_of_a_page_run_in_order(
    page, tmp_path, tmp_path_factory, rig_session, my_folder, annotate_cloud, made, monkeypatch
):
    """What several pages ask of the same files is run once."""
    prepare(page, tmp_path, rig_session, my_folder)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli.rig_devices, "VIRTUAL_FRAMES", 3)
    monkeypatch.setattr(annotate.person.alignment, "GROUPS", 3)
    monkeypatch.setattr(synth.rig.film, "SHORTEST_S", 0.1)
    monkeypatch.setattr(synth.rig.film, "FRAMES_PER_SECOND", 15.0)
    monkeypatch.setitem(TEMPLATES, REFERENCE, SMALL_RIG)
    if page == "docs/retrain.md":
        monkeypatch.setattr("eval.training.segmentation.train.SAMPLING", Sampling(0.012, 32))
    if page != "docs/cluster.md":
        monkeypatch.setattr(synth.images.workers, "processes", here)
    for command in commands_of(page):
        if left_out(command):
            continue
        small = smaller(command)
        if small.startswith("annotate-cloud learn "):
            accept_all_but_one(tmp_path / shlex.split(small)[2])
            monkeypatch.setattr(os, "nice", lambda by: 0)
            monkeypatch.setattr(eval.fine_tuning.run, "MOST_STEPS", 1)
            monkeypatch.setattr(eval.fine_tuning.run, "MORE", 1.0)
            monkeypatch.setattr(eval.fine_tuning.fine_tune.FineTuned, "better", True)  # nothing was corrected
        wanted, before = asked(small), set(tmp_path.iterdir())
        if wanted in made:
            copied(made[wanted].iterdir(), tmp_path)
            continue
        done = annotate_cloud(*shlex.split(small)[1:])
        assert done.code == 0, f"{small}: {done.err}"
        made[wanted] = tmp_path_factory.mktemp("made")
        copied(set(tmp_path.iterdir()) - before, made[wanted])

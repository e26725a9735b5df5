"""Every command that the documentation shows is parsed, and run page by page on small sizes."""

import hashlib
import os
import re
import shlex
import shutil
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import tree
from typer.main import get_command

import cli.rig_devices
import eval.fine_tuning.cross_validation
import eval.fine_tuning.run
import eval.fine_tuning.training_split
import synth.images.workers
from annotate.correction.correction import Correction
from cli.main import app
from eval.training.segmentation.augmentation import Sampling
from sensors.session.reader import Session
from synth.images.workers import Workers
from synth.rig.simulate import suit_path, truth_path

ROOT = Path(__file__).parent.parent
PAGES = ["README.md", *(f"docs/{p.name}" for p in sorted((ROOT / "docs").glob("*.md")))]

ELSEWHERE = {
    "make": "the set-up itself",
    "export": "the set-up itself",
    "pip install": "the set-up itself: test_packaging.py",
    "annotate-cloud --install-completion": "writes to the user's own files: test_cli_completion.py",
    "annotate-cloud compile": "the set-up itself: make setup runs it",
    "annotate-cloud fix": "a window: the tests of the window",
    "annotate-cloud record take.mcap --rig": "devices; docs/camera.md records from their twins",
    "annotate-cloud live": "devices and a screen: test_live.py, test_foxglove.py",
    "annotate-cloud benchmark": "recordings of others: test_benchmark.py",
    "annotate-cloud models": "models of others: test_annotate_witness.py",
    "annotate-cloud adapt": "labels by a model of others: test_eval_adaptation.py",
    "annotate-cloud predict people.mcap --weights adapted": "the network of adapt",
    "annotate-cloud try": "models of others: test_try.py",
    "annotate-cloud report tried": "label sets of try: test_eval_agreement.py",
    "annotate-cloud compare tried": "label sets of try: test_eval_agreement.py",
    "annotate-cloud label people.mcap --by colour": "models of others: test_witness_labels.py",
    "python -m tools.measure.colour_people": "models of others: test_tools_rgbd.py",
    "podman": "a container engine",
    "dask": "scheduler and workers: the tests of generating",
}
"""Commands that are tested elsewhere, by their start."""
SIZES = {
    "simulate board.mcap": {"--frames": "12"},
    "simulate people.mcap": {"--frames": "8", "--subjects": "4", "--seed": "6", "--difficulty": "normal"},
    "simulate": {"--frames": "4", "--subjects": "4", "--seed": "6"},
    "synth generate": {"--count": "4", "--workers": "1", "--scheduler": ""},
    "train sitting": {"--epochs": "1", "--network": "compact-small"},
    "train": {"--epochs": "1"},
    "train-labels": {"--steps": "1"},
    "record": {"--seconds": "1"},
}
"""Options that make a command small, by its start."""


def commands_of(page: str) -> list[str]:
    """Return the lines of a page's shell blocks, without comments and empty lines."""
    blocks = re.findall(r"^```sh\n(.*?)^```", (ROOT / page).read_text(), re.M | re.S)
    lines = "\n".join(blocks).replace("\\\n", " ").splitlines()
    return [line.split(" #")[0].replace(".venv/bin/", "").strip() for line in lines if line.strip()]


def left_out(command: str) -> bool:
    return any(command.startswith(start) for start in ELSEWHERE)


def test_every_command_is_understood_and_every_exception_is_met():
    shown = [command for page in PAGES for command in commands_of(page)]
    assert all(any(command.startswith(start) for command in shown) for start in ELSEWHERE)
    understood = 0
    for command in shown:
        assert command.startswith("annotate-cloud ") or left_out(command)
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


def small(command: str) -> list[str]:
    """Return the words of a command, without the program, with the options of SIZES."""
    words = shlex.split(command)[1:]
    start = next((start for start in SIZES if " ".join(words).startswith(f"{start} ")), None)
    for option, value in SIZES.get(start, {}).items():
        if option in words:
            at = words.index(option)
            words[at : at + 2] = []
        if option != "--network" or "--init" not in words:
            words += [option, value]
    return words


@pytest.fixture(scope="module")
def my_folder(tmp_path_factory, rig_session) -> Path:
    """Return a user's own images."""
    from tests.helpers.page_material import write_image_folder

    folder = tmp_path_factory.mktemp("docs") / "my-folder"
    write_image_folder(folder, Session(rig_session))
    return folder


def prepare(page: str, folder: Path, rig_session: Path, my_folder: Path) -> None:
    """Write the user's own files that a page assumes."""
    text = (ROOT / page).read_text()
    if "my-folder" in text:
        shutil.copytree(my_folder, folder / "my-folder")
    if "monday.mcap" in text:
        shutil.copy(suit_path(rig_session), folder / "ours.toml")
        for day in ("monday", "tuesday", "wednesday"):
            shutil.copy(rig_session, folder / f"{day}.mcap")
            shutil.copytree(truth_path(rig_session), folder / day)
    if "walk.c3d" in text:
        from tests.helpers.page_material import write_trials

        write_trials(folder)


@contextmanager
def here(count: int) -> Iterator[Workers]:
    """Run makers of shards in this process."""
    with ThreadPoolExecutor(count) as pool:
        yield Workers(pool, count)


def learn_a_little(labels: Path, monkeypatch) -> None:
    """Accept all frames but one, as in the window, and shorten fine-tuning, which has nothing to improve."""
    with Correction.open(labels) as correction:
        for frame_id in correction.labels.frame_ids[1:]:
            correction.edit(frame_id).judge("accept")
    monkeypatch.setattr(os, "nice", lambda by: 0)
    monkeypatch.setattr(eval.fine_tuning.run, "MOST_STEPS", 1)
    monkeypatch.setattr(eval.fine_tuning.training_split, "FOLDS", 2)
    monkeypatch.setattr(eval.fine_tuning.cross_validation, "SHARES", (1.0,))
    monkeypatch.setattr(eval.fine_tuning.cross_validation.Gain, "is_certain", True)


def copied(paths: Iterable[Path], folder: Path) -> None:
    for path in paths:
        (shutil.copytree if path.is_dir() else shutil.copy)(path, folder / path.name)


@pytest.fixture(scope="module")
def made() -> dict[tuple[str, ...], Path]:
    """Return folders with the outputs of commands, by their words and the content of their inputs."""
    return {}


@pytest.mark.usefixtures("draft_rigs")
@pytest.mark.parametrize("page", [page for page in PAGES if any(not left_out(c) for c in commands_of(page))])
def test_the_commands_of_a_page_run_in_order(
    page, tmp_path, tmp_path_factory, rig_session, my_folder, annotate_cloud, made, monkeypatch
):
    """A command that several pages run on the same files runs once."""
    prepare(page, tmp_path, rig_session, my_folder)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("eval.training.segmentation.train.SAMPLING", Sampling(0.012, 32))
    monkeypatch.setattr(cli.rig_devices, "VIRTUAL_FRAMES", 3)
    if page != "docs/cluster.md":
        monkeypatch.setattr(synth.images.workers, "processes", here)
    for command in commands_of(page):
        if left_out(command):
            continue
        words = small(command)
        if words[0] == "learn":
            learn_a_little(Path(words[1]), monkeypatch)
        inputs = [path for path in map(Path, words) if path.exists()]
        contents = [tree(p) if p.is_dir() else hashlib.sha256(p.read_bytes()).hexdigest() for p in inputs]
        key, before = (*words, str(contents)), set(tmp_path.iterdir())
        if key in made:
            copied(made[key].iterdir(), tmp_path)
            continue
        done = annotate_cloud(*words)
        assert done.code == 0, f"{command}: {done.err}"
        made[key] = tmp_path_factory.mktemp("made")
        copied(set(tmp_path.iterdir()) - before, made[key])

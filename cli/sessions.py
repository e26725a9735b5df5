"""A verb applied to every session of a folder: one after another here, or in parallel on a dask cluster.

Workers read and write the same paths as the command. A task resumes after a killed one, and its output does
not depend on the machine.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from typer import Option

from cli.console import clear, finish, progress, say, table
from cli.remedies import remedied
from sensors.errors import CloudError
from sensors.files.atomic import check_folder_name
from sensors.files.natural_order import paths_in_order
from sensors.importers.open_source import open_source
from sensors.session.recording_file import SUFFIX
from sensors.versions import code_digest, different, versions

if TYPE_CHECKING:
    from annotate.label_recording import Run
    from sensors.importers.open_source import Source
    from synth.images.workers import Workers

T = TypeVar("T")
DECISIVE = ("annotate-cloud", "numpy", "numba", "opencv-contrib-python-headless", "onnxruntime")
"""Packages whose versions decide the bytes of labels."""

Scheduler = Annotated[
    str | None,
    Option(help="For a folder of sessions: a dask cluster, by its scheduler's address tcp://HOST:8786."),
]


def recordings_in(folder: Path, *, foreign: bool = False) -> list[Path]:
    """Return the MCAP files of a folder with sessions, in order; none where the folder is a recording itself.

    foreign: include files of other programs; else a folder with such files is a recording.
    """
    if not folder.is_dir() or (folder / "metadata.yaml").exists() or (folder / "depth").exists():
        return []
    from sensors.session.recognise import mcap_files

    sessions, others, unknown = mcap_files(folder)
    wanted = sessions if foreign else not others
    return paths_in_order([*sessions, *others, *unknown]) if wanted else []


def open_recording(path: Path, names: bool) -> "Source":
    """Open a recording. names: its labels may hold the subject's name."""
    source = open_source(path)
    source.named = names
    return source


def sessions_in(folder: Path, scheduler: str | None) -> dict[str, Path]:
    """Return the sessions of a folder by name.

    Raises BadParameter where a scheduler is given but the folder has no sessions.
    """
    found = {path.stem: path for path in recordings_in(folder)}
    if scheduler and not found:
        raise typer.BadParameter(f"{folder} is not a folder of sessions (*{SUFFIX}); leave out --scheduler")
    return found


def label_sets_in(predicted: Path, truth: Path, scheduler: str | None) -> dict[str, tuple[Path, Path]]:
    """Return the label sets of a folder by name, each with its truth: NAME or NAME.truth of the other folder.

    The result is empty where the folder is itself a label set. Raises BadParameter where a scheduler is given
    but the folder has no label sets, CloudError for a label set without a truth.
    """
    from annotate.labelset.labelled_frames import holds_frames

    alone = holds_frames(predicted) or not predicted.is_dir()
    found = [] if alone else paths_in_order(path for path in predicted.iterdir() if holds_frames(path))
    if scheduler and not found:
        raise typer.BadParameter(f"{predicted} is not a folder of label sets; leave out --scheduler")
    pairs = {}
    for path in found:
        known = [truth / path.name, truth / f"{path.name}.truth"]
        pairs[path.name] = path, next((each for each in known if holds_frames(each)), known[0])
        if not holds_frames(pairs[path.name][1]):
            raise CloudError(f"{path.name} has no truth; put {known[0]} or {known[1].name} beside it")
    return pairs


def each(
    title: str, work: Callable[..., T], jobs: Mapping[str, tuple[Any, ...]], scheduler: str | None
) -> tuple[dict[str, T], dict[str, str]]:
    """Return the results of ``work`` on every job's arguments, and the errors, by the job's name.

    Raises CloudError where the cluster cannot be reached or is lost.
    """
    from synth.images.workers import cluster

    done: dict[str, T] = {}
    failed: dict[str, str] = {}
    with (
        cluster(scheduler) if scheduler else nullcontext() as workers,
        progress(title, len(jobs)) as advance,
    ):
        for name, outcome in _outcomes(work, jobs, workers):
            try:
                done[name] = outcome()
            except (CloudError, OSError) as error:
                # Other sessions may be on another disk or have other permissions.
                failed[name] = remedied(error)
            advance(1)
    return {name: done[name] for name in jobs if name in done}, failed


def _outcomes(
    work: Callable[..., T], jobs: Mapping[str, tuple[Any, ...]], workers: "Workers | None"
) -> Iterator[tuple[str, Callable[[], T]]]:
    """Yield each job's name and a function that returns or raises its outcome, in the order of completion."""
    if workers is None:
        yield from ((name, partial(work, *job)) for name, job in jobs.items())
        return
    from concurrent.futures import as_completed

    here = _decisive()
    names = {workers.executor.submit(_checked, here, work, *job): name for name, job in jobs.items()}
    for future in as_completed(names):
        yield names[future], future.result


def _decisive() -> dict[str, str]:
    return versions(DECISIVE) | {"code": code_digest("sensors", "annotate", "synth", "eval")}


def _checked(wanted: dict[str, str], work: Callable[..., T], *job: object) -> T:
    """Return a job's outcome. Raises CloudError if the worker's versions differ, because its output might
    differ.
    """
    if (here := _decisive()) != wanted:
        raise CloudError(f"a worker has {different(here, wanted)}; install the same versions everywhere")
    return work(*job)


@dataclass(frozen=True)
class EachOptions:
    """Options of a verb for every session of a folder. scheduler: address of a cluster, None = here."""

    scheduler: str | None
    overwrite: bool
    json: bool


def label_each(
    title: str,
    work: Callable[[Path, Path], "Run"],
    sessions: Mapping[str, Path],
    out: Path,
    options: EachOptions,
) -> None:
    """Label every session into a label set of its name, and print the number of frames of each.

    work: (session, label set) -> run. Exits with 3 where a session or a frame failed.
    """
    from annotate.labelset import label_set as store

    check_folder_name(out)
    for name, path in sessions.items():
        clear(out / name, store.MANIFEST, options.overwrite, path)
    out.mkdir(parents=True, exist_ok=True)
    jobs = {name: (path.resolve(), (out / name).resolve()) for name, path in sessions.items()}
    runs, failed = each(title, work, jobs, options.scheduler)
    rows = {name: {"frames": len(run.labels), "failed": len(run.failed)} for name, run in runs.items()}
    for name, run in runs.items():
        say(*(f"{name}, frame {frame}: {why}" for frame, why in run.failed))
    finish_each(rows, failed, options.json, out)


def finish_each(
    rows: Mapping[str, Mapping[str, Any]], failed: Mapping[str, str], json: bool, out: Path | None
) -> None:
    """Print a row per session; exit with 3 if a session or frame failed. Raises CloudError if all failed."""
    say(*(f"{name}: {why}" for name, why in failed.items()))
    if not rows:
        raise CloudError(f"none of the {len(failed)} sessions could be done; the lines above say why")
    heads = list(next(iter(rows.values())))
    text = table(("session", *heads), [(name, *row.values()) for name, row in rows.items()])
    result = {"sessions": dict(rows), "failed": dict(failed), "out": str(out) if out else None}
    finish(result, json, text)
    if failed or any(row.get("failed") for row in rows.values()):
        raise typer.Exit(3)

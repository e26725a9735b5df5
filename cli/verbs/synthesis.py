"""Verbs on synthetic people: synth bodies, generate, page and film."""

import sys
import time
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from cli.console import Json, Overwrite, check_room, clear, finish, progress, say
from cli.console import table as draw_table
from cli.extras import needing
from cli.scheme import PAPER, SchemeName
from cli.verbs.simulation import CameraFile, CastName, Difficulty, difficulties, own_camera, record_rig
from sensors.errors import CloudError
from sensors.files.atomic import check_free, check_there
from sensors.importers.open_source import opener_at
from sensors.session.recording_file import SUFFIX
from synth.data_files import TRAINING, Cast, check_choice

if TYPE_CHECKING:
    from annotate.labelset.dataset import Dataset
    from synth.body.body import Body
    from synth.body.body_table import BodySize
    from synth.images.presets import Preset

PICTURE = "bodies.png"
Beside = Annotated[
    Path | None,
    Option(metavar="RECORDING", help="Recording or label set of real people to compare on the page."),
]
Motion = "Motion of solve, BVH, C3D, TRC, or a file of joint positions (.npz)"
app = typer.Typer(help="Synthetic bodies and datasets of depth images.", no_args_is_help=True)


def presets() -> list[str]:
    """Return the names of the presets of `synth generate`."""
    from synth.images.presets import PRESETS

    return list(PRESETS)


@app.command()
def bodies(
    out: Annotated[Path, Option(help=f"Folder for the bodies and their picture, {PICTURE}.")],
    table: Annotated[
        Path | None,
        Option(help="CSV file: name,height_cm,weight_kg,waist_breadth_cm. Default: the paper's bodies."),
    ] = None,
    sample: Annotated[
        int | None,
        Option(help="Number of random adults of all ages and builds, instead of a table.", min=1, max=1000),
    ] = None,
    seed: Annotated[int, Option(help="The same seed gives the same random adults.", min=0)] = 0,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Fit bodies to height, weight and waist breadth. Needs the extra 'bodies'."""
    from synth.body.body import save_body
    from synth.body.body_picture import picture, save_picture
    from synth.body.body_table import MEASURES, PAPER_BODIES, describe, read_sizes

    if table is not None and sample is not None:
        raise CloudError("--table and --sample exclude each other; give one of them")
    asked = PAPER_BODIES if table is None else read_sizes(table)
    sizes: Sequence[BodySize | None] = asked if sample is None else [None] * sample
    names = [f"sample_{i:03}" if size is None else size.name for i, size in enumerate(sizes)]
    for path in (out / PICTURE, *(out / f"{name}.npz" for name in names)):
        check_free(path, overwrite)
    made = _bake(names, sizes, seed)
    out.mkdir(parents=True, exist_ok=True)
    for body in made:
        save_body(out / f"{body.name}.npz", body)
    save_picture(out / PICTURE, picture(made))
    rows = [describe(body, size) for body, size in zip(made, sizes, strict=True)]
    columns = [key for m in MEASURES for key in (m, f"asked_{m}") if key in rows[0]]
    lines = [(row["model"], *(f"{row[key]:.2f}" for key in columns)) for row in rows]
    text = draw_table(("body", *(key.replace("_", " ") for key in columns)), lines)
    finish({"bodies": rows}, json, text)


def _bake(names: list[str], sizes: "Sequence[BodySize | None]", seed: int) -> "list[Body]":
    """Return bodies fitted to their sizes; a size of None gives a random adult."""
    import numpy as np

    with needing("bodies"):
        from synth.body.fit import BodyModel, fit, random_adult

    rng = np.random.default_rng(seed)
    # Libraries under anny print to stdout.
    with redirect_stdout(sys.stderr):
        model = BodyModel()
    made = []
    with progress("fit bodies", len(sizes)) as advance:
        for name, size in zip(names, sizes, strict=True):
            phenotype = random_adult(rng) if size is None else fit(model, size)
            made.append(model.bake(name, phenotype))
            advance(1)
    return made


def _preset(name: str | None, motion: Path | None, garments: Path | None, cast: Cast) -> "Preset":
    """Return the preset of a name or a motion; dressed in the garments of a folder, if any.

    Raises CloudError for the judging cast with motions or garments, because these are of the training cast.
    """
    from synth.images.presets import dressed_from, preset_named, preset_of
    from synth.motion.library import motion_files, read_repertoire

    if cast != TRAINING and (motion or garments):
        option = "--motion" if motion else "--garments"
        raise CloudError(f"--cast {cast} and {option} exclude each other; give one of them")
    if motion is None:
        chosen = preset_named(str(name), cast)
    else:
        with progress("read motions", len(motion_files(motion))) as advance:
            repertoire = read_repertoire(motion, advance)
        say(*repertoire.assumed)
        chosen = preset_of(repertoire)
    return chosen if garments is None else dressed_from(chosen, garments)


def _check_beside(recording: Path | None) -> None:
    """Raise CloudError for a path that is neither a label set nor an importable recording."""
    from annotate.labelset.label_set import MANIFEST

    if recording is not None and not (recording / MANIFEST).is_file():
        opener_at(recording)


Count = Annotated[
    int | None, Option(help="Number of images. Default: the preset's own.", min=1, max=1_000_000_000)
]


@app.command("generate")
def generate_(
    out: Annotated[Path, Option(help="Folder for the shards; an interrupted run continues there.")],
    preset: Annotated[
        str | None,
        Option(
            help="people, standing, sitting-train, sitting-test, recumbent or upright.",
            autocompletion=presets,
        ),
    ] = None,
    motion: Annotated[
        Path | None,
        Option(help=f"Instead of a preset: poses of recorded people. {Motion}, or a folder of these."),
    ] = None,
    count: Count = None,
    workers: Annotated[int, Option(help="Processes on this machine.", min=1, max=256)] = 2,
    scheduler: Annotated[
        str | None, Option(help="Use a dask cluster instead: address of the scheduler, tcp://HOST:8786.")
    ] = None,
    seed: Annotated[int, Option(help="The same seed gives the same bytes.", min=0)] = 0,
    occluders: Annotated[
        float, Option(help="Share of images with objects in front of the person.", min=0, max=1)
    ] = 0.0,
    cut: Annotated[
        float, Option(help="Share of images with holes in the extracted person.", min=0, max=1)
    ] = 0.0,
    garments: Annotated[
        Path | None, Option(help="Folder of MakeHuman garments (.mhclo) that half of the people wear.")
    ] = None,
    camera: CameraFile = None,
    beside: Beside = None,
    cast: CastName = TRAINING,
    scheme: SchemeName = PAPER,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Generate labelled depth images of people as tar shards, with a page of pictures and statistics."""
    from annotate.labelset.dataset import ORDER
    from annotate.scheme.scheme_file import load_scheme

    with needing("synth"):
        from synth.images.distributions import distributions_at
        from synth.images.generate import Order, generate
        from synth.images.workers import cluster, processes

    _check_sources(preset, motion, garments, beside)
    inputs = list(filter(None, (motion, garments, camera, beside)))
    check_room(out, ORDER, overwrite, *inputs)
    own = own_camera(camera, "faults of all sensors in turn")
    chosen = replace(_preset(preset, motion, garments, cast), occluders=occluders, cut=cut)
    chosen = replace(chosen, scheme=load_scheme(scheme), sensor=own or chosen.sensor)
    order = Order(chosen, chosen.count if count is None else count, seed)
    recording, started = distributions_at(beside) if beside else None, time.monotonic()
    with (
        cluster(scheduler) if scheduler else processes(workers) as hands,
        progress("generate", order.count) as advance,
    ):
        # After the start of the workers, so that an unreachable scheduler keeps the old dataset.
        clear(out, ORDER, overwrite, *inputs)
        made = generate(order, out, hands, advance, recording)
    _finish(made.dataset, made.images / (time.monotonic() - started), out, json)


def _finish(dataset: "Dataset", rate: float, out: Path, json: bool) -> None:
    """Print the size of a dataset. rate: images a second."""
    count, shards = len(dataset), len(dataset.shards)
    result = {"images": count, "images_per_second": round(rate, 1), "shards": shards}
    finish(result, json, f"{count} images in {shards} shards in {out}, {rate:.0f} a second")


def _check_sources(
    preset: str | None, motion: Path | None, garments: Path | None, beside: Path | None
) -> None:
    """Raise CloudError unless one of preset and motion is given and all files exist."""
    from synth.motion.library import motion_files

    if preset is None and motion is None:
        raise CloudError("neither --preset nor --motion is given; give one of them")
    if preset is not None and motion is not None:
        raise CloudError("--preset and --motion exclude each other; give one of them")
    if motion is not None:
        motion_files(motion)
    check_there(*filter(None, [garments]))
    _check_beside(beside)


@app.command()
def page(
    dataset: Annotated[Path, Argument(help="Dataset that synth generate wrote.")],
    beside: Beside = None,
    json: Json = False,
) -> None:
    """Draw the page of a dataset again, compared with a recording of real people."""
    from annotate.labelset.dataset import ORDER, Dataset

    with needing("synth"):
        from synth.images.dataset_page import PAGE, write_page
        from synth.images.distributions import distributions_at

    opened = Dataset.open(dataset)
    if not (dataset / ORDER).is_file():
        raise CloudError(f"{dataset} was not made by synth generate; give a folder with {ORDER}")
    _check_beside(beside)
    recording = None if beside is None else distributions_at(beside)
    write_page(opened, recording)
    finish({"page": str(dataset / PAGE)}, json, f"{dataset / PAGE}")


@app.command()
def film(
    motion: Annotated[Path, Argument(help=f"{Motion}.")],
    out: Annotated[Path, Argument(metavar="out.mcap", help="Session to write.")],
    take: Annotated[
        str | None, Option(help="Name of the take, if the file has several.", show_default="the only one")
    ] = None,
    difficulty: Difficulty = "normal",
    scheme: SchemeName = PAPER,
    seed: Annotated[int, Option(help="The same seed gives the same session.", min=0)] = 0,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Record a motion with the virtual rig, 30 frames a second; the true labels go to out.truth/."""
    from annotate.scheme.scheme_file import load_scheme

    with needing("synth"):
        from synth.motion.library import check_motion, is_motion, read_take
        from synth.rig.film import FilmRig

    check_choice("difficulty", difficulty, difficulties())
    check_free(out, overwrite, suffix=SUFFIX)
    parts = load_scheme(scheme)
    check_motion(motion)
    name, moved = read_take(motion, take)
    say(*(() if is_motion(motion) else moved.report.assumed))
    record_rig("film", FilmRig(name, moved, difficulty, seed, parts), out, overwrite, json)

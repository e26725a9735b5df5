"""Verbs on synthetic people: synth bodies, synth generate."""

import csv
import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from cli.console import Json, Overwrite, clear, finish, progress
from sensors.errors import CloudError, ExistsError
from synth.body import load_body, save_body
from synth.generate import ORDER, Order, generate
from synth.sample import preset_named
from synth.workers import cluster, processes

MEASURES = ("height_cm", "weight_kg", "waist_breadth_cm")
app = typer.Typer(help="Bodies and datasets of synthetic depth images.", no_args_is_help=True)


@app.command()
def bodies(
    out: Annotated[Path, typer.Option(help="Folder for the baked bodies.")],
    table: Annotated[
        Path | None,
        typer.Option(help="CSV: name,height_cm,weight_kg,waist_breadth_cm. Default: the paper's eight."),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Fit the parametric body to height, weight and waist breadth, and bake it. Needs the extra 'synth'."""
    from synth.fit import PAPER_BODIES, BodyModel, BodySize, fit

    sizes = PAPER_BODIES
    if table is not None:
        try:
            with table.open(newline="", encoding="utf-8") as file:
                rows = list(csv.DictReader(file))
            sizes = tuple(
                BodySize(Path(row["name"]).name, *(float(row[c]) for c in MEASURES)) for row in rows
            )
        except (KeyError, TypeError, ValueError) as error:
            raise CloudError(
                f"{table} is no table of bodies ({error}); give columns name,{','.join(MEASURES)}"
            ) from error
    out.mkdir(parents=True, exist_ok=True)
    model, made = BodyModel(), []
    with progress("fit bodies", len(sizes)) as advance:
        for size in sizes:
            path = out / f"{size.name}.npz"
            if path.exists() and not overwrite:
                raise ExistsError(f"{path} exists already; choose another folder or pass --overwrite")
            save_body(path, model.bake(size.name, fit(model, size)))
            body = load_body(path)
            measured = (body.height_cm, body.weight_kg, body.waist_breadth_cm)
            made.append(
                {"model": size.name} | dict(zip(MEASURES, (round(v, 2) for v in measured), strict=True))
            )
            advance(1)
    finish({"bodies": made}, json, "\n".join(", ".join(f"{k} {v}" for k, v in body.items()) for body in made))


@app.command("generate")
def generate_(
    preset: Annotated[str, typer.Option(help="sitting-train, sitting-test or recumbent.")],
    out: Annotated[Path, typer.Option(help="Folder for the shards; a broken run goes on there.")],
    count: Annotated[int | None, typer.Option(help="Images; default: the paper's number.")] = None,
    workers: Annotated[int, typer.Option(help="Processes of this machine.", min=1, max=256)] = 2,
    scheduler: Annotated[
        str | None, typer.Option(help="Use a dask cluster instead: its scheduler's address, tcp://HOST:8786.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Same seed, same bytes.")] = 0,
    occluders: Annotated[float, typer.Option(help="Share of images with things before the person.")] = 0.0,
    cut: Annotated[float, typer.Option(help="Share of images with holes in the extraction.")] = 0.0,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Generate labelled depth images of people as tar shards, with a page of pictures and statistics."""
    chosen = replace(preset_named(preset), occluders=occluders, cut=cut)
    order = Order(chosen, chosen.count if count is None else count, seed)
    started = time.monotonic()
    with (
        cluster(scheduler) if scheduler else processes(workers) as hands,
        progress("generate", order.count) as advance,
    ):
        # Not before the workers are there: a dead scheduler costs no old dataset.
        clear(out, ORDER, overwrite)
        made = generate(order, out, hands, advance)
    rate = made.images / (time.monotonic() - started)
    shards = len(made.dataset.shards)
    result = {"images": order.count, "images_per_second": round(rate, 1), "shards": shards}
    finish(result, json, f"{order.count} images in {shards} shards in {out}, {rate:.0f} a second")

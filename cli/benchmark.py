"""Verbs that measure joints on recordings with true joints: benchmark itop, benchmark joints."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer import Argument, Option

from cli.console import Json, Overwrite, block, check_room, clear, finish, progress, say, table
from cli.extras import check_extra
from sensors.errors import FormatError
from sensors.files.atomic import check_there

if TYPE_CHECKING:
    from eval.benchmark.benchmark_set import BenchmarkSet

app = typer.Typer(help="Measure joints within 10 cm on recordings with true joints.", no_args_is_help=True)
Weights = Annotated[Path | None, Option(help="Network (.onnx).", show_default="the shipped one")]


@app.command()
def itop(
    folder: Annotated[Path, Argument(help="Folder with ITOP's test files of depth and labels (.h5).")],
    out: Annotated[Path, Option(help="Folder for a label set of each view; a later run continues there.")],
    view: Annotated[Literal["side", "top"] | None, Option(help="View. Default: all in the folder.")] = None,
    weights: Weights = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Measure the network on ITOP's valid test frames, beside published figures."""
    check_extra("benchmark", "h5py")
    check_there(folder, *([weights] if weights else []))
    from eval.benchmark.itop import VIEWS, paths_of, read_itop

    views = [view] if view else [one for one in VIEWS if any(p.exists() for p in paths_of(folder, one))]
    if not views:
        raise FormatError(f"{folder} holds no ITOP_VIEW_test_*.h5; give the folder of ITOP's unpacked files")
    sets = {one: read_itop(folder, one) for one in views}
    found = {one: _measured(given, out / one, weights, overwrite, one) for one, given in sets.items()}
    result = {"views": {one: answer for one, (answer, _) in found.items()}}
    finish(result, json, block(*(text for _, text in found.values())))


@app.command()
def joints(
    recording: Annotated[Path, Argument(help="Session, folder of depth images, or what import reads.")],
    out: Annotated[Path, Option(help="Label set to write; a later run continues there.")],
    truth: Annotated[
        Path | None, Option(help="True joints (.jsonl).", show_default="joints.jsonl in the folder")
    ] = None,
    weights: Weights = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Measure the network on any recording with true joints, in a file as `predict --joints` writes it."""
    from eval.benchmark.joint_truth import JOINTS_FILE, read_joint_truth
    from sensors.importers.open_source import doubts_of, open_source

    path = truth or recording / JOINTS_FILE
    check_there(recording, *([weights] if weights else []))
    if not truth and not path.exists():
        raise FormatError(f"{recording} has no {JOINTS_FILE}; give --truth FILE")
    source = open_source(recording)
    given = read_joint_truth(source, path)
    for note in (*source.notes, *doubts_of(source)):
        say(note)
    answer, text = _measured(given, out, weights, overwrite, "")
    finish(answer, json, text)


def _measured(
    given: "BenchmarkSet", out: Path, weights: Path | None, overwrite: bool, view: str
) -> tuple[dict[str, Any], str]:
    """Label a benchmark set into ``out`` as ``predict`` does; return its precision as JSON and as tables.

    view: of ITOP, for published figures; or "".
    """
    from annotate.labelset import label_set as store
    from eval.benchmark.published import KINDS, PUBLISHED
    from eval.network.onnx_network import SHIPPED_WEIGHTS, OnnxNetwork
    from eval.network.predict import PredictOptions
    from eval.network.predict_source import predict_source
    from eval.network.refine import shipped_refinement_network

    inputs = [path for path in (given.source.path, weights) if path]
    check_room(out, store.MANIFEST, overwrite, *inputs)
    network = OnnxNetwork(weights or SHIPPED_WEIGHTS)
    clear(out, store.MANIFEST, overwrite, *inputs)
    options = PredictOptions(room_refiner=shipped_refinement_network())
    with progress(f"predict {out.name}", len(given.source)) as advance:
        run = predict_source(given.source, network, out, advance, options)
    every, visible, nobody = given.precision(run.labels)
    for frame, why in run.failed:
        say(f"frame {frame} is counted as missed: {why}")
    if every.note:
        say(every.note)
    kinds = [name.rpartition("_")[2] for name in given.joints]
    others = [one for one in PUBLISHED if view == "side" and one.joints]
    rows: list[tuple[object, ...]] = []
    for kind in dict.fromkeys(kinds):
        own = [k == kind for k in kinds]
        figures = [one.joints[KINDS.index(kind)] for one in others]
        rows.append((kind, *(_percent(found.by_joint[own].mean()) for found in (every, visible)), *figures))
    rows.append(("mean", _percent(every.mean), _percent(visible.mean), *(one.side for one in others)))
    low, high = map(_percent, every.ci95)
    people = every.people or "unknown"
    heading = (
        f"{given.source.name}: joints within 10 cm, % of {every.frames} frames of {people} people; "
        f"mean {_percent(every.mean)} [{low}, {high}]; {nobody} frames without a predicted person"
    )
    texts = [table(("joint", "all", "visible", *(one.method for one in others)), rows, heading)]
    means = [(one.method, getattr(one, view), one.paper) for one in PUBLISHED if view and getattr(one, view)]
    if means:
        texts.append(table(("trained on ITOP", "mean, %", "paper"), means))
    answer = every.to_json(given.joints) | {"frames_without_person": nobody}
    return answer | {"visible": visible.to_json(given.joints)}, block(*texts)


def _percent(share: float) -> str:
    return f"{100 * share:.1f}" if math.isfinite(share) else "-"

"""Verbs that measure labels and show results: evaluate, compare, diff, report."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from cli.console import Json, Overwrite, finish, progress, provenance, say
from cli.extras import check_extra, needing
from cli.sessions import Scheduler, each, finish_each, label_sets_in
from sensors.errors import ExistsError
from sensors.files.atomic import check_free, check_there

if TYPE_CHECKING:
    from annotate.labelset.labelled_frames import LabelledFrames
    from eval.compare.compare import Comparison


def evaluate(
    predicted: Annotated[Path, Argument(help="Label set or dataset; or a folder of label sets.")],
    truth: Annotated[Path, Argument(help="Label set or dataset; or a folder of them, NAME or NAME.truth.")],
    out: Annotated[
        Path | None, Option(help="Result (.npz) to write, for 'compare' and 'report'; of folders, a folder.")
    ] = None,
    title: Annotated[str, Option(help="Name of the result in the report.")] = "Network",
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Measure labels against the truth, with confidence intervals and the confusion matrix."""
    if pairs := label_sets_in(predicted, truth, scheduler):
        _evaluate_each(pairs, out, title, scheduler, overwrite, json)
        return
    if out is not None:
        check_free(out, overwrite)
    from annotate.labelset.labelled_frames import open_frames

    guesses, targets = open_frames(predicted), open_frames(truth)
    from cli.score_tables import scores_text
    from eval.compare.compare import compare_sets
    from eval.compare.details import details
    from eval.compare.results import Result, save_result

    with progress("evaluate", len(targets)) as advance:
        comparison = compare_sets(guesses, targets, advance)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        facts = _facts(guesses, targets, comparison, provenance())
        save_result(out, Result(title, comparison, facts), overwrite)
    result = {**comparison.to_evaluation_json(), **details(comparison)}
    if comparison.ci_note:
        say(comparison.ci_note)
    finish(result, json, scores_text(comparison, intervals=True))


def _evaluate_each(
    pairs: dict[str, tuple[Path, Path]],
    out: Path | None,
    title: str,
    scheduler: str | None,
    overwrite: bool,
    json: bool,
) -> None:
    """Measure every label set of a folder, with one result each; existing results are kept."""
    jobs = {}
    for name, (predicted, truth) in pairs.items():
        path = out / f"{name}.npz" if out else None
        if path and not overwrite and _is_older(path, predicted, truth):
            raise ExistsError(
                f"{path} is older than the labels it measures; pass --overwrite to measure again"
            )
        where = path.resolve() if path else None
        named = f"{title}: {name}"
        jobs[name] = (predicted.resolve(), truth.resolve(), where, named, overwrite, provenance())
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    done, failed = each("evaluate", _evaluate_one, jobs, scheduler)
    shown = {
        name: {"frames": scores["frames"], **{k: scores[k] for k in ("mean_recall", "miou", "person_iou")}}
        for name, scores in done.items()
    }
    finish_each(shown, failed, json, out)


def _is_older(result: Path, *sets: Path) -> bool:
    """Return whether a label set changed after its result; the folder's time shows it, because writes replace
    files.
    """
    folders = [folder for path in sets for folder in (path, path / "frames") if folder.is_dir()]
    changed_ns = max(folder.stat().st_mtime_ns for folder in folders)
    return result.exists() and result.stat().st_mtime_ns < changed_ns


def _evaluate_one(
    predicted: Path, truth: Path, out: Path | None, title: str, overwrite: bool, origin: dict[str, str]
) -> dict[str, Any]:
    """Return the summary of one label set's scores; write its result unless it exists. Any machine may run
    this.
    """
    from annotate.labelset.labelled_frames import open_frames
    from eval.compare.compare import compare_sets
    from eval.compare.results import Result, load_result, save_result

    if out is not None and out.exists() and not overwrite:
        return load_result(out).comparison.to_json()
    guesses, targets = open_frames(predicted), open_frames(truth)
    comparison = compare_sets(guesses, targets, workers=1)
    if out is not None:
        facts = _facts(guesses, targets, comparison, origin)
        save_result(out, Result(title, comparison, facts), overwrite)
    return comparison.to_json()


def _facts(
    predicted: "LabelledFrames", truth: "LabelledFrames", comparison: "Comparison", origin: dict[str, str]
) -> dict[str, str]:
    """Return the facts needed to repeat a result. origin: the command and its version."""
    weights: object = predicted.info
    for key in ("steps", "predict", "weights"):
        weights = weights.get(key) if isinstance(weights, dict) else None
    facts = {
        **origin,
        "predicted": str(predicted.path),
        "truth": str(truth.path),
        **{f"{name} hash": value for name, value in comparison.hashes.items()},
        "source": str(truth.info.get("source", "")),
        "network": weights if isinstance(weights, str) else "",
    }
    return {name: fact for name, fact in facts.items() if fact}


def compare(
    a: Annotated[Path, Argument(help="Result that 'evaluate --out' wrote.")],
    b: Annotated[Path, Argument(help="Result to compare with the first.")],
    json: Json = False,
) -> None:
    """Show by how much result A is better than result B, and how certain that is."""
    check_there(a, b)
    from eval.compare.results import check_results, load_result

    check_results(a, b)

    first, second = load_result(a), load_result(b)
    from cli.score_tables import difference_text
    from eval.compare.paired import difference

    found = difference(first, second)
    if found.note:
        say(found.note)
    finish(found.to_json(), json, difference_text(found))


def diff(
    a: Annotated[Path, Argument(help="Label set or dataset.")],
    b: Annotated[Path, Argument(help="Label set or dataset to take as the truth.")],
    json: Json = False,
) -> None:
    """Compare label set A with label set B in a few scores; 'evaluate' computes more scores."""
    from annotate.labelset.labelled_frames import open_frames

    sets = open_frames(a), open_frames(b)
    from cli.score_tables import scores_text
    from eval.compare.compare import compare_sets

    with progress("compare", len(sets[1])) as advance:
        comparison = compare_sets(*sets, advance)
    finish(comparison.to_json(), json, scores_text(comparison, intervals=False))


def report(
    results: Annotated[list[Path], Argument(help="Results of 'evaluate --out'; the first is the baseline.")],
    out: Annotated[Path, Option(help="HTML file to write; .csv, .json and .tex are saved beside it.")],
    ceiling: Annotated[
        Path | None, Option(help="Result of one person's corrections against another's.")
    ] = None,
    session: Annotated[
        list[Path] | None, Option(help="Recording of the labels, to show its clouds; repeatable.")
    ] = None,
    history: Annotated[
        list[Path] | None, Option(help="Folder of 'train', to show loss and scores; repeatable.")
    ] = None,
    audit: Annotated[
        list[Path] | None, Option(help="Corrected label set, to show each person's corrections; repeatable.")
    ] = None,
    shown: Annotated[
        list[Path] | None, Option(help="Label set without a truth, to show it; repeatable.")
    ] = None,
    note: Annotated[list[str] | None, Option(help="Text for each --shown, in the same order.")] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write one page with all results beside the paper's results; the page opens offline."""
    check_extra("report", "jinja2", "plotly")
    notes, sets = note or [], shown or []
    if len(notes) > len(sets):
        raise typer.BadParameter(f"{len(notes)} notes for {len(sets)} label sets; give --shown for each")
    check_free(out, overwrite)
    given = [*results, *([ceiling] if ceiling else [])]
    check_there(*given, *sets)
    from eval.compare.results import check_results, load_result

    check_results(*given)
    from sensors.session.reader import Session

    loaded = [load_result(path) for path in results]
    # These imports take a second, which a refusal need not spend.
    with needing("report"):
        from eval.report.gather import gather
        from eval.report.page import free_outputs, write_report

    free_outputs(out, overwrite)
    material = gather(
        loaded,
        load_result(ceiling) if ceiling else None,
        [Session(path) for path in session or []],
        history or [],
        audit or [],
        dict(zip(sets, [*notes, *[""] * len(sets)], strict=False)),
        provenance(),
    )
    written = write_report(out, material, overwrite)
    finish({"path": str(out), "files": [str(path) for path in written]}, json, str(out))

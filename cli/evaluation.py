"""Verbs that measure labels and show what was measured: evaluate, compare, diff, report."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from cli.console import Json, Overwrite, finish, progress, provenance, say
from cli.extras import needing
from sensors.files.atomic import check_free

if TYPE_CHECKING:
    from annotate.labelset.frames import LabelledFrames
    from eval.compare.compare import Comparison


def evaluate(
    predicted: Annotated[Path, Argument(help="Label set or dataset.")],
    truth: Annotated[Path, Argument(help="Label set or dataset.")],
    out: Annotated[Path | None, Option(help="Result (.npz) to write, for 'compare' and 'report'.")] = None,
    title: Annotated[str, Option(help="Name of the result in the report.")] = "Network",
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Measure labels against the truth, with confidence intervals and the confusion matrix."""
    with needing("report"):
        import scipy  # noqa: F401, for the intervals at the end

    if out is not None:
        check_free(out, overwrite)
    from annotate.labelset.frames import open_frames

    guesses, targets = open_frames(predicted), open_frames(truth)
    from cli.score_tables import scores_text
    from eval.compare.compare import compare_sets
    from eval.compare.details import details
    from eval.compare.results import Result, save_result

    with progress("evaluate", len(targets)) as advance:
        comparison = compare_sets(guesses, targets, advance)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        save_result(out, Result(title, comparison, _facts(guesses, targets, comparison)), overwrite)
    result = {**comparison.to_evaluation_json(), **details(comparison)}
    if comparison.ci_note:
        say(comparison.ci_note)
    finish(result, json, scores_text(comparison, intervals=True))


def _facts(predicted: "LabelledFrames", truth: "LabelledFrames", comparison: "Comparison") -> dict[str, str]:
    """What is needed to repeat the result."""
    weights: object = predicted.info
    for key in ("steps", "predict", "weights"):
        weights = weights.get(key) if isinstance(weights, dict) else None
    facts = {
        **provenance(),
        "predicted": str(predicted.path),
        "truth": str(truth.path),
        **{f"{name} hash": value for name, value in comparison.hashes.items()},
        "source": str(truth.info.get("source", "")),
        "network": weights if isinstance(weights, str) else "",
    }
    return {name: fact for name, fact in facts.items() if fact}


def compare(
    a: Annotated[Path, Argument(help="Result that 'evaluate --out' wrote.")],
    b: Annotated[Path, Argument(help="Result to compare it with.")],
    json: Json = False,
) -> None:
    """Show by how much result A is better than result B, and how certain that is."""
    with needing("report"):
        import scipy  # noqa: F401
    from cli.score_tables import difference_text
    from eval.compare.paired import difference
    from eval.compare.results import load_result

    found = difference(load_result(a), load_result(b))
    if found.note:
        say(found.note)
    finish(found.to_json(), json, difference_text(found))


def diff(
    a: Annotated[Path, Argument(help="Label set or dataset.")],
    b: Annotated[Path, Argument(help="Label set or dataset to take as the truth.")],
    json: Json = False,
) -> None:
    """Compare label set A with label set B in a few scores; 'evaluate' computes more scores."""
    from annotate.labelset.frames import open_frames

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
        list[Path] | None, Option(help="Corrected label set, to show who did what; repeatable.")
    ] = None,
    shown: Annotated[
        list[Path] | None, Option(help="Label set without a truth, to show it; repeatable.")
    ] = None,
    note: Annotated[list[str] | None, Option(help="Text for each --shown, in the same order.")] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write one page with all results beside those of the paper; it opens offline."""
    # These imports take a second, which the other verbs need not spend.
    with needing("report"):
        from eval.report.build import free_outputs, write_report
        from eval.report.gather import gather
    from eval.compare.results import load_result
    from sensors.session.reader import Session

    notes, sets = note or [], shown or []
    if len(notes) > len(sets):
        raise typer.BadParameter(f"{len(notes)} notes for {len(sets)} label sets; give --shown for each")
    free_outputs(out, overwrite)
    material = gather(
        [load_result(path) for path in results],
        load_result(ceiling) if ceiling else None,
        [Session(path) for path in session or []],
        history or [],
        audit or [],
        dict(zip(sets, [*notes, *[""] * len(sets)], strict=False)),
        provenance(),
    )
    written = write_report(out, material, overwrite)
    finish({"path": str(out), "files": [str(path) for path in written]}, json, str(out))

"""Verbs that measure labels and compare what was measured: evaluate, compare."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from annotate.labelset.frames import LabelledFrames, open_frames
from cli.console import Json, Overwrite, finish, progress, provenance, say
from cli.extras import needing
from cli.score_tables import difference_text, scores_text
from eval.compare.compare import Comparison, compare_sets
from eval.compare.details import details
from eval.compare.paired import difference
from eval.compare.results import Result, load_result, save_result
from sensors.files.atomic import check_free


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
        import scipy.stats  # noqa: F401, for the intervals at the end

    if out is not None:
        check_free(out, overwrite)
    guesses, targets = open_frames(predicted), open_frames(truth)
    with progress("evaluate", len(targets)) as advance:
        comparison = compare_sets(guesses, targets, advance)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        save_result(out, Result(title, comparison, _facts(guesses, targets, comparison)), overwrite)
    result = {**comparison.to_evaluation_json(), **details(comparison)}
    if comparison.ci_note:
        say(comparison.ci_note)
    finish(result, json, scores_text(comparison, intervals=True))


def _facts(predicted: LabelledFrames, truth: LabelledFrames, comparison: Comparison) -> dict[str, str]:
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
        import scipy.stats  # noqa: F401

    found = difference(load_result(a), load_result(b))
    if found.note:
        say(found.note)
    finish(found.to_json(), json, difference_text(found))

"""Verbs that measure labels and compare what was measured: evaluate, compare."""

import shlex
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from cli.console import Json, Overwrite, finish, progress, say
from cli.extras import needing
from eval.compare.compare import Comparison, compare_sets
from eval.compare.details import details
from eval.compare.paired import difference
from eval.compare.results import Result, check_size, load_result, save_result
from eval.scores.frames import Frames, open_frames
from sensors.files.atomic import check_free

SHOWN = ("mean_recall", "miou", "person_iou", "boundary_f", "left_right_swap_rate")
"""Scores that are printed; the rest is in the JSON."""


def evaluate(
    predicted: Annotated[Path, typer.Argument(metavar="PREDICTED", help="Label set or dataset.")],
    truth: Annotated[Path, typer.Argument(metavar="TRUTH", help="Label set or dataset.")],
    out: Annotated[
        Path | None, typer.Option(help="Result file to write, for 'compare' and 'report'.")
    ] = None,
    title: Annotated[str, typer.Option(help="Name of the result in the report.")] = "Network",
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Measure labels against the truth, with confidence intervals and the confusion matrix."""
    with needing("report"):
        import scipy.stats  # noqa: F401, which the intervals ask for at the end

    if out is not None:
        check_free(out, overwrite)
    guesses, targets = open_frames(predicted), open_frames(truth)
    if out is not None:
        check_size(len(targets))
    with progress("evaluate", len(targets)) as advance:
        comparison = compare_sets(guesses, targets, advance)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        save_result(out, Result(title, comparison, _facts(guesses, targets, comparison)), overwrite)
    result = {**comparison.to_evaluation_json(), **details(comparison)}
    if comparison.ci_note:
        say(comparison.ci_note)
    lines = [f"{result['frames']} frames of {result['subjects']} subjects"]
    lines += [f"{name}: {_with_interval(comparison, name)}" for name in SHOWN]
    finish(result, json, "\n".join(lines))


def _facts(predicted: Frames, truth: Frames, comparison: Comparison) -> dict[str, str]:
    """What is needed to repeat the result."""
    weights: object = predicted.info
    for key in ("steps", "predict", "weights"):
        weights = weights.get(key) if isinstance(weights, dict) else None
    facts = {
        "command": shlex.join(["annotate-cloud", *sys.argv[1:]]),
        "version": version("annotate-cloud"),
        "predicted": str(predicted.path),
        "truth": str(truth.path),
        **{f"{name} hash": value for name, value in comparison.hashes.items()},
        "source": str(truth.info.get("source", "")),
        "network": weights if isinstance(weights, str) else "",
    }
    return {name: fact for name, fact in facts.items() if fact}


def _with_interval(comparison: Comparison, name: str) -> str:
    low, high = comparison.ci95[name]
    return f"{comparison.scores[name]:.4f} ({low:.4f} to {high:.4f})"


def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="Result that 'evaluate --out' wrote.")],
    b: Annotated[Path, typer.Argument(metavar="B", help="Result to compare it with.")],
    json: Json = False,
) -> None:
    """Show by how much result A is better than result B, and how certain that is."""
    with needing("report"):
        import scipy.stats  # noqa: F401

    found = difference(load_result(a), load_result(b))
    lines = [f"{found.a} minus {found.b}, {'on the same frames' if found.paired else 'on different frames'}"]
    for name in SHOWN:
        low, high = found.ci95[name]
        p = found.wilcoxon_p.get(name)
        lines.append(
            f"{name}: {found.values[name]:+.4f} ({low:+.4f} to {high:+.4f})"
            + (f", Wilcoxon p {p:.3f}" if p is not None else "")
        )
    if found.note:
        say(found.note)
    finish(found.to_json(), json, "\n".join(lines))

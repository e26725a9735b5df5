"""Verbs that measure labels and show what was measured: evaluate, report."""

from pathlib import Path
from typing import Annotated

import typer

from annotate import store
from annotate.store import LabelSet
from cli.console import Json, Overwrite, finish
from eval.compare import compare_sets
from eval.report.build import write_report
from eval.results import Result, load_result, save_result


def evaluate(
    predicted: Annotated[Path, typer.Argument(metavar="PREDICTED", help="Label set.")],
    truth: Annotated[Path, typer.Argument(metavar="TRUTH", help="Label set.")],
    out: Annotated[Path | None, typer.Option(help="Keep the result here for 'report' (JSON).")] = None,
    title: Annotated[str, typer.Option(help="Name of the result in the report.")] = "Network",
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Measure a label set against the truth, with confidence intervals and the confusion matrix."""
    comparison = compare_sets(LabelSet.open(predicted), LabelSet.open(truth))
    if out is not None:
        facts = {"predicted": str(predicted), "truth": str(truth)}
        out.parent.mkdir(parents=True, exist_ok=True)
        save_result(out, Result(title, comparison, facts), overwrite)
    result = comparison.to_evaluation_json()
    shown = {k: result[k] for k in ("frames", "mean_recall", "miou", "person_iou", "left_right_swap_rate")}
    finish(result, json, "\n".join(f"{key}: {value}" for key, value in shown.items()))


def report(
    results: Annotated[list[Path], typer.Argument(help="Results that 'evaluate --out' kept.")],
    out: Annotated[Path, typer.Option("--file", "--out", help="HTML file to write.")],
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Put results side by side, with the paper's, on one page that opens offline."""
    from eval.report.gallery import make_gallery

    loaded = [load_result(path) for path in results]
    galleries = {}
    for result in loaded:
        sets = [Path(result.facts.get(k, "")) for k in ("predicted", "truth")]
        if all((path / store.MANIFEST).is_file() for path in sets):
            predicted, truth = (LabelSet.open(path) for path in sets)
            galleries[result.title] = make_gallery(result.comparison, predicted, truth)
    write_report(out, loaded, galleries, overwrite=overwrite)
    finish({"path": str(out)}, json, str(out))

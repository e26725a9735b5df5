"""Verbs that measure labels and show results: evaluate, compare, diff, report."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer
from typer import Argument, Option

from cli.agreement import agreement_text, are_label_sets, compared, open_sets, write_page
from cli.console import Json, Overwrite, finish, progress, provenance, say
from cli.extras import check_extra, needing
from cli.scheme import names
from cli.sessions import Scheduler, each, finish_each, label_sets_in
from sensors.errors import ExistsError
from sensors.files.atomic import check_free, check_there
from sensors.importers.open_source import opener_at

if TYPE_CHECKING:
    from annotate.labelset.labelled_frames import LabelledFrames
    from annotate.scheme.scheme import Scheme
    from eval.compare.compare import Comparison

RESULT, PAGE = ".npz", ".html"  # suffixes of outputs


def evaluate(
    predicted: Annotated[Path, Argument(help="Label set or dataset; or a folder of label sets.")],
    truth: Annotated[Path, Argument(help="Label set or dataset; or a folder of them, NAME or NAME.truth.")],
    out: Annotated[
        Path | None, Option(help="Result (.npz) to write, for 'compare' and 'report'; of folders, a folder.")
    ] = None,
    title: Annotated[
        str | None,
        Option(help="Name of the result in comparisons and reports.", show_default="the name of the labels"),
    ] = None,
    scheme: Annotated[
        str | None,
        Option(
            help="Scheme of parts to compare in: name, or file (TOML).",
            show_default="the finest of both label sets",
            autocompletion=names,
        ),
    ] = None,
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Measure labels against the truth, with confidence intervals and the confusion matrix."""
    from annotate.scheme.scheme_file import load_scheme

    chosen, title = load_scheme(scheme) if scheme else None, title or predicted.resolve().name
    if pairs := label_sets_in(predicted, truth, scheduler):
        given = _Job(predicted, truth, out, title, chosen, overwrite, provenance())
        jobs = _jobs(pairs, given)
        done, failed = each("evaluate", _evaluate_one, jobs, scheduler)
        names = ("frames", "mean_recall", "miou", "person_iou")
        shown = {set_name: {name: scores[name] for name in names} for set_name, scores in done.items()}
        finish_each(shown, failed, json, out)
        return
    if out is not None:
        check_free(out, overwrite, suffix=RESULT)
    from annotate.labelset.labelled_frames import open_frames

    guesses, targets = open_frames(predicted), open_frames(truth)
    from cli.score_tables import scores_text
    from eval.compare.compare import compare_sets
    from eval.compare.details import details

    with progress("evaluate", len(targets)) as advance:
        comparison = compare_sets(guesses, targets, advance, scheme=chosen)
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        job = _Job(predicted, truth, out, title, chosen, overwrite, provenance())
        _save(job, guesses, targets, comparison)
    result = {**comparison.to_evaluation_json(), **details(comparison)}
    say(*_notes(guesses, targets, comparison), *([comparison.ci_note] if comparison.ci_note else []))
    finish(result, json, scores_text(comparison, intervals=True))


class _Job(NamedTuple):
    """Label set to measure. scheme: of the comparison, or None. origin: the command and its version."""

    predicted: Path
    truth: Path
    out: Path | None
    title: str
    scheme: "Scheme | None"
    overwrite: bool
    origin: dict[str, str]


def _jobs(pairs: dict[str, tuple[Path, Path]], given: _Job) -> dict[str, tuple[_Job]]:
    """Return the label sets of folders to measure; given: the folders.

    Raises ExistsError for an outdated result.
    """
    jobs, out = {}, given.out
    for name, (predicted, truth) in pairs.items():
        path = out / f"{name}{RESULT}" if out else None
        if path and not given.overwrite and _is_older(path, predicted, truth):
            raise ExistsError(
                f"{path} is older than the labels it measures; pass --overwrite to measure again"
            )
        where = path.resolve() if path else None
        own = given._replace(predicted=predicted.resolve(), truth=truth.resolve(), out=where)
        jobs[name] = (own._replace(title=f"{given.title}: {name}"),)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
    return jobs


def _is_older(result: Path, *sets: Path) -> bool:
    """Return True if a label set has changed since a result: replaced files change the folder's time."""
    folders = [folder for path in sets for folder in (path, path / "frames") if folder.is_dir()]
    changed_ns = max(folder.stat().st_mtime_ns for folder in folders)
    return result.exists() and result.stat().st_mtime_ns < changed_ns


def _evaluate_one(job: _Job) -> dict[str, Any]:
    """Return the summary of a label set's scores, measured or read from its result."""
    from annotate.labelset.labelled_frames import open_frames
    from eval.compare.compare import compare_sets
    from eval.compare.results import load_result

    if job.out is not None and job.out.exists() and not job.overwrite:
        known = load_result(job.out).comparison
        if job.scheme not in (None, known.scheme):
            raise ExistsError(
                f"{job.out} has scheme {known.scheme.name!r}; pass --overwrite to measure again"
            )
        return known.to_json()
    guesses, targets = open_frames(job.predicted), open_frames(job.truth)
    comparison = compare_sets(guesses, targets, workers=1, scheme=job.scheme)
    if job.out is not None:
        _save(job, guesses, targets, comparison)
    return comparison.to_json()


def _save(job: _Job, predicted: "LabelledFrames", truth: "LabelledFrames", comparison: "Comparison") -> None:
    """Write a result with the facts needed to reproduce it."""
    from eval.compare.results import Result, save_result

    assert job.out is not None
    weights: object = predicted.info
    for key in ("steps", "predict", "weights"):
        weights = weights.get(key) if isinstance(weights, dict) else None
    facts = {
        **job.origin,
        "predicted": str(predicted.path),
        "truth": str(truth.path),
        **{f"{name} hash": value for name, value in comparison.hashes.items()},
        "source": str(truth.info.get("source", "")),
        "network": weights if isinstance(weights, str) else "",
        "notes": "; ".join(_notes(predicted, truth, comparison)),
    }
    facts = {name: fact for name, fact in facts.items() if fact}
    save_result(job.out, Result(job.title, comparison, facts), job.overwrite)


def _scheme_note(predicted: "LabelledFrames", truth: "LabelledFrames", comparison: "Comparison") -> str:
    """Return a note of the scheme of a comparison; "" where both label sets have it."""
    from eval.compare.common_scheme import scheme_note

    if predicted.scheme == truth.scheme == comparison.scheme:
        return ""
    return f"{scheme_note(comparison.scheme)} (labels: {predicted.scheme.name}, truth: {truth.scheme.name})"


def _notes(predicted: "LabelledFrames", truth: "LabelledFrames", comparison: "Comparison") -> list[str]:
    """Return the notes of a comparison: its scheme, exchanged sets, people that trained the networks."""
    from annotate.labelset.cast_note import known_people_note

    exchanged = predicted.info.get("made_by") == "simulate" and truth.info.get("made_by") != "simulate"
    notes = (
        _scheme_note(predicted, truth, comparison),
        f"{predicted.path} is a simulation's truth; name the truth second" if exchanged else "",
        known_people_note(truth.info),
    )
    return [note for note in notes if note]


def compare(
    paths: Annotated[
        list[Path],
        Argument(
            metavar="A B ...",
            help="Two results of 'evaluate --out'; or two or more label sets of the same frames.",
        ),
    ],
    json: Json = False,
) -> None:
    """Show the differences of scores between results A and B, or how far label sets agree, each with each."""
    check_there(*paths)
    if are_label_sets(paths):
        agreements = compared(open_sets(paths))
        finish({"pairs": [one.to_json() for one in agreements]}, json, agreement_text(agreements))
        return
    if len(paths) != 2:
        raise typer.BadParameter(f"the number of results is {len(paths)}; give two")
    from eval.compare.results import check_results, load_result

    check_results(*paths)
    first, second = map(load_result, paths)
    from cli.score_tables import difference_text
    from eval.compare.difference import difference

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
    say(*_notes(*sets, comparison))
    finish(comparison.to_json(), json, scores_text(comparison, intervals=False))


def report(
    results: Annotated[
        list[Path],
        Argument(help="Results of 'evaluate --out', baseline first; or label sets of the same frames."),
    ],
    out: Annotated[Path, Option(help="HTML file to write; of results, also .csv, .json and .tex.")],
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
    shown: Annotated[list[Path] | None, Option(help="Label set without a truth; repeatable.")] = None,
    note: Annotated[list[str] | None, Option(help="Text for each --shown, in the same order.")] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write one offline page with all results and the paper's, or on label sets, each with each."""
    check_extra("report", "jinja2", "plotly")
    if are_label_sets(results):
        if ceiling or history or audit or shown or note or len(session or []) > 1:
            raise typer.BadParameter("a report on label sets takes --session alone, once")
        _report_on_sets(results, next(iter(session or []), None), out, overwrite, json)
        return
    notes, sets = note or [], shown or []
    if len(notes) > len(sets):
        raise typer.BadParameter(
            f"the number of notes is {len(notes)}, of --shown {len(sets)}; give --shown for each note"
        )
    check_free(out, overwrite, suffix=PAGE)
    given = [*results, *([ceiling] if ceiling else [])]
    check_there(*given, *sets)
    from eval.compare.results import check_results, load_result

    check_results(*given)
    from sensors.session.reader import Session

    loaded = [load_result(path) for path in results]
    with needing("report"):
        from eval.report.gather import Sources, gather
        from eval.report.page import free_outputs, write_report

    free_outputs(out, overwrite)
    sources = Sources(
        results=loaded,
        ceiling=load_result(ceiling) if ceiling else None,
        sessions=[Session(path) for path in session or []],
        trainings=history or [],
        audited=audit or [],
        shown=dict(zip(sets, [*notes, *[""] * len(sets)], strict=False)),
        facts=provenance(),
    )
    written = write_report(out, gather(sources), overwrite)
    finish({"path": str(out), "files": [str(path) for path in written]}, json, str(out))


def _report_on_sets(paths: list[Path], session: Path | None, out: Path, overwrite: bool, json: bool) -> None:
    check_free(out, overwrite, suffix=PAGE)
    if session is not None:
        opener_at(session)
    sets = open_sets(paths)
    found = compared(sets)
    write_page(sets, found, session, out)
    pairs = [one.to_json() for one in found]
    finish({"path": str(out), "pairs": pairs}, json, agreement_text(found), "", str(out))

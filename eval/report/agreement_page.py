"""Page on label sets of the same frames: the worst frames, and how far parts, joints and posture agree."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from annotate.frame_labels import FrameLabels
from annotate.labelset.labelled_frames import LabelledFrames
from annotate.labelset.source_recording import Recorded
from annotate.scheme.merging import conversion_table
from eval.compare.common_scheme import converted
from eval.report import figures
from eval.report.agreement import TURNED_DEG, Agreement
from eval.report.estimates import AGREED_JOINTS, agreed, agreement_row, printed
from eval.report.frame_images import Image
from eval.report.gallery import compared_images
from eval.report.html_page import Head, Section, html_of
from eval.scores.joints import JOINT_NAMES
from eval.scores.traits import writable
from sensors.files.atomic import write_bytes

WORST = 12  # frames shown; untuned


@dataclass(frozen=True)
class Compared:
    """Label sets by name, and the agreement of each pair.

    recorded: their recording, for camera pictures. notes: remarks on the labels. facts: command, version.
    """

    sets: Mapping[str, LabelledFrames]
    found: Sequence[Agreement]
    recorded: Recorded | None = None
    notes: Sequence[str] = ()
    facts: Mapping[str, str] = field(default_factory=dict)


def write_agreement(path: Path, compared: Compared) -> None:
    """Write the page, in place of an earlier one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, agreement_html(compared).encode(errors="replace"))


def agreement_html(compared: Compared) -> str:
    """Return the page as HTML; the same sets give the same bytes."""
    of = compared.found[-1].comparison
    lead = (
        f"{', '.join(compared.sets)}: {len(of.frame_ids)} frames, scheme "
        f"{of.scheme.name}. None of them is the truth. The second set of each pair is the reference."
    )
    return html_of(Head("Agreement of label sets", lead), _sections(compared))


def worst_frames(found: Sequence[Agreement]) -> list[tuple[str, Agreement, float]]:
    """Return the frame of least mIoU in each of ``WORST`` spans of the recording, the worst first, with the
    pair that disagrees there.

    Neighbouring frames look alike, so the worst of all would be one moment.
    """
    frame_ids = found[0].comparison.frame_ids
    at = [{f: i for i, f in enumerate(one.comparison.frame_ids)} for one in found]
    chosen = []
    for span in np.array_split(np.arange(len(frame_ids)), min(WORST, len(frame_ids))):
        scored = [
            (float(one.comparison.frame_miou[rows[frame_ids[i]]]), frame_ids[i], one)
            for i in span
            for one, rows in zip(found, at, strict=True)
            if frame_ids[i] in rows
        ]
        known = [row for row in scored if not np.isnan(row[0])]
        chosen += [min(known, key=lambda row: row[0])] if known else []
    return [(frame_id, one, miou) for miou, frame_id, one in sorted(chosen, key=lambda row: row[0])]


def _sections(compared: Compared) -> Iterator[Section]:
    found, results = compared.found, [one.result for one in compared.found]
    scheme = found[0].comparison.scheme
    yield Section(
        "Worst frames",
        "The frame of least mIoU in each span of the recording, the worst first. Labels also "
        "agree where both are wrong in the same way, so look at the pictures.",
        rows=list(_rows(compared)),
        legends={"": scheme.parts},
    )
    yield Section(
        "Agreement",
        "Recall is the share of the reference's pixels with the same label, averaged over the parts. Joints "
        f"are the subject's, in the image. Facings agree within {TURNED_DEG:.0f} degrees. Intervals are "
        "95 %, over people; fewer than two known people give none.",
        notes=compared.notes,
        figures={"mIoU of every frame": figures.over_frames(results)},
        tables=[("Pairs", _pair_table(found)), ("IoU by part", _part_table(found))],
    )
    if any(one.comparison.joints for one in found):
        yield Section(
            "Joints",
            "Distance of the joints of both sets, and the share within 100 mm.",
            tables=[("By joint", _joint_table(found))],
        )
    postures = _posture_table(found)
    if len(postures):
        yield Section("Posture", "Number of frames by posture.", tables=[("Postures", postures)])
    sources = {one.b: one.result.facts["truth"] for one in found}
    sources = {one.a: one.result.facts["predicted"] for one in found} | sources
    yield Section(
        "Sources", "Undefined pixels of a reference are ignored.", facts={**compared.facts, **sources}
    )


def _rows(compared: Compared) -> Iterator[tuple[str, Mapping[str, Image]]]:
    """Yield caption and images of the worst frames."""
    scheme = compared.found[0].comparison.scheme
    entries = {name: {e.frame_id: e for e in one.entries()} for name, one in compared.sets.items()}
    tables = {name: conversion_table(one.scheme, scheme) for name, one in compared.sets.items()}
    for frame_id, pair, miou in worst_frames(compared.found):
        labels = {
            name: converted(one.load(entries[name][frame_id]), scheme, tables[name])
            for name, one in compared.sets.items()
            if frame_id in entries[name]
        }
        color = _color(compared.recorded, labels[pair.b])
        yield (
            writable(f"{frame_id} · {pair.result.title} · mIoU {miou:.3f}"),
            compared_images(labels, (pair.a, pair.b), color),
        )


def _color(recorded: Recorded | None, labels: FrameLabels) -> Image | None:
    if recorded is None:
        return None
    cloud = recorded.fused(labels).cloud
    return cloud.color_rgb if cloud.color_valid.any() else None


def _frame(rows: list[dict[str, str]]) -> pd.DataFrame:
    return pd.DataFrame([{writable(k): writable(v) for k, v in row.items()} for row in rows], dtype=object)


def _pair_table(found: Sequence[Agreement]) -> pd.DataFrame:
    """Return a row of scores for each pair."""
    return _frame([{"Labels": one.result.title, **agreement_row(one)} for one in found])


def _part_table(found: Sequence[Agreement]) -> pd.DataFrame:
    parts = found[0].comparison.scheme.parts
    return _frame(
        [
            {
                "Part": part.title,
                **{one.result.title: printed("iou", agreed(one, "iou", part.id)) for one in found},
            }
            for part in parts
        ]
    )


def _joint_table(found: Sequence[Agreement]) -> pd.DataFrame:
    rows = []
    for joint in JOINT_NAMES:
        row = {"Joint": joint.replace("_", " ")}
        for one in found:
            for name, title in AGREED_JOINTS.items():
                row[f"{one.result.title}: {title}"] = printed(name, agreed(one, name, joint=joint))
        rows.append(row)
    return _frame(rows)


def _posture_table(found: Sequence[Agreement]) -> pd.DataFrame:
    """Return the number of frames by posture, a row for each set; empty without postures."""
    counts = {one.a: Counter(a for a, _ in one.postures) for one in found}
    counts |= {one.b: Counter(b for _, b in one.postures) for one in found}
    names = sorted({name for of in counts.values() for name in of if name})
    rows = [
        {"Labels": title, **{name: str(of[name]) for name in names}, "not sure": str(of[""])}
        for title, of in counts.items()
    ]
    return _frame(rows if names else [])

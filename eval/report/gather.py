"""Data of a report, gathered from files before the page is drawn."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import NoReturn

import numpy as np

from annotate.array_types import Bool
from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction.audit import Audit, audit
from annotate.crop import Crop
from annotate.frame_labels import FrameLabels
from annotate.labelset.journal import Journal
from annotate.labelset.label_set import LabelSet
from annotate.labelset.labelled_frames import camera_of, holds_frames, open_frames
from eval.compare.paired import Difference, difference
from eval.compare.pairs import pair_up
from eval.compare.results import Result
from eval.report.frame_images import Image
from eval.report.gallery import (
    EACH,
    GalleryFrame,
    Scene,
    cloud_picture,
    make_frame,
    make_scene,
    make_shown_frame,
    pick_frames,
)
from eval.report.training_history import Training, load_training
from sensors.errors import CloudError
from sensors.session.reader import Session

SHOWN_FRAMES = 12
"""Frames shown of a label set without a truth, evenly spread; untuned."""
SCENES = 12
"""Scenes of all results together, 0.2 MB each; untuned."""


@dataclass(frozen=True)
class ShownSet:
    """Labels of frames without a truth, which the report shows but does not score. note: a remark on them."""

    title: str
    frames: Sequence[GalleryFrame]
    scenes: Sequence[Scene] = ()
    note: str = ""


@dataclass(frozen=True)
class Material:
    """Data of a report.

    results: in display order; the others are compared with the first. ceiling: two corrections of the same
    frames compared, the best score that labelling can reach. galleries: frames by the title of their result.
    scenes: frames to rotate in 3D. trainings: of the networks compared. audits: people's correction work, by
    the title of the label set. shown: label sets without truth. facts: commands, seeds and hashes, shown
    unchanged. Raises CloudError without results, or for two equal titles.
    """

    results: tuple[Result, ...]
    ceiling: Result | None = None
    galleries: Mapping[str, Sequence[GalleryFrame]] = field(default_factory=dict)
    scenes: Sequence[Scene] = ()
    trainings: Sequence[Training] = ()
    audits: Mapping[str, Audit] = field(default_factory=dict)
    shown: Sequence[ShownSet] = ()
    facts: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.results:
            raise CloudError("there are no results; give at least one that evaluate wrote")
        titles = [result.title for result in self.results]
        twice = next((title for title in titles if titles.count(title) > 1), None)
        if twice is not None:
            raise CloudError(f"two results have the title {twice!r}; evaluate one again with another --title")

    @cached_property
    def differences(self) -> list[Difference]:
        """Return the difference of every later result to the first."""
        return [difference(result, self.results[0]) for result in self.results[1:]]


class Clouds:
    """Fused clouds of recorded sessions, by session name and frame id."""

    def __init__(self, sessions: Sequence[Session]) -> None:
        self._fusers = {session.name: (session, Fuser(session.calibration)) for session in sessions}
        self._drawn: dict[str, Image | None] = {}

    def of(self, source: str, frame: FrameLabels) -> ThermalCloud | None:
        """Return the cloud of a frame labelled from ``source``; None where no session has an equal depth
        image.
        """
        if source not in self._fusers or not frame.frame_id.isascii() or not frame.frame_id.isdigit():
            return None
        session, fuser = self._fusers[source]
        if int(frame.frame_id) >= len(session):
            return None
        cloud = fuser.fuse_frame(session.frame(int(frame.frame_id)))
        return cloud if np.array_equal(cloud.depth_mm, frame.depth_mm) else None

    def picture(self, source: str, frame: FrameLabels, person: Bool, crop: Crop) -> Image | None:
        """Return the picture of a frame's cloud by ``cloud_picture``, cached for all results that show it."""
        pixels = hashlib.sha256(np.ascontiguousarray(frame.depth_mm).data)
        pixels.update(np.packbits(person).data)
        key = f"{source}/{frame.frame_id}/{pixels.hexdigest()}"
        if key not in self._drawn:
            cloud = self.of(source, frame)
            self._drawn[key] = None if cloud is None else cloud_picture(cloud, person, crop)
        return self._drawn[key]


def gather(
    results: Sequence[Result],
    ceiling: Result | None = None,
    sessions: Sequence[Session] = (),
    trainings: Sequence[Path] = (),
    audited: Sequence[Path] = (),
    shown: Mapping[Path, str] | None = None,
    facts: Mapping[str, str] | None = None,
    each: int = EACH,
) -> Material:
    """Return the data of the report.

    shown: label sets without truth, each with a note. A result whose label sets have been moved is shown
    without pictures. Raises FormatError for a corrupt file, CloudError where labels were changed after their
    evaluation.
    """
    clouds = Clouds(sessions)
    galleries: dict[str, list[GalleryFrame]] = {}
    scenes: list[Scene] = []
    for result in results:
        galleries[result.title], own = pictures_of(result, clouds, each)
        scenes += own[: max(1, SCENES // len(results))]
    shown_sets = [shown_set(LabelSet.open(path), note, clouds) for path, note in (shown or {}).items()]
    scenes += [scene for one in shown_sets for scene in one.scenes]
    return Material(
        results=tuple(results),
        ceiling=ceiling,
        galleries=galleries,
        scenes=scenes,
        trainings=[load_training(folder) for folder in trainings],
        audits={path.name: audit(LabelSet.open(path), Journal.of(path)) for path in audited},
        shown=shown_sets,
        facts=facts or {},
    )


def pictures_of(result: Result, clouds: Clouds, each: int) -> tuple[list[GalleryFrame], list[Scene]]:
    """Return a result's gallery, and the first frame of each group as a scene; empty without its label
    sets.
    """
    sets = [Path(result.facts[name]) for name in ("predicted", "truth") if name in result.facts]
    if len(sets) < 2 or not all(holds_frames(path) for path in sets):
        return [], []
    predicted, truth = (open_frames(path) for path in sets)
    picked = pick_frames(result.comparison, each)
    pairs = {pair.truth.frame_id: pair for pair in pair_up(predicted, truth)[0]}
    scores = dict(zip(result.comparison.frame_ids, result.comparison.frame_miou, strict=True))
    frames, scenes = [], []
    for group, frame_ids in picked.items():
        for place, frame_id in enumerate(frame_ids):
            pair = pairs.get(frame_id) or _changed(result, frame_id, sets)
            guess, target = predicted.load(pair.predicted), truth.load(pair.truth)
            source = str(truth.info.get("source", ""))
            frame = make_frame(target, guess, partial(clouds.picture, source, target), group)
            if not np.isclose(frame.miou, scores[frame_id], rtol=0, atol=1e-9):
                _changed(result, frame_id, sets)
            frames.append(frame)
            if not place:
                title = f"{result.title} · {group.lower()} · {frame_id}"
                cloud = clouds.of(source, target)
                scenes.append(make_scene(title, guess, camera_of(truth, target), target, cloud))
    return frames, [scene for scene in scenes if scene is not None]


def _changed(result: Result, frame_id: str, sets: Sequence[Path]) -> NoReturn:
    raise CloudError(
        f"frame {frame_id} of {sets[0]} or {sets[1]} is not what {result.title!r} was measured on; "
        "evaluate again"
    )


def shown_set(labels: LabelSet, note: str, clouds: Clouds) -> ShownSet:
    """Return frames of a label set, evenly spread over it, and its first frame as a scene."""
    ids = labels.frame_ids
    chosen = sorted({ids[i] for i in np.linspace(0, len(ids) - 1, min(SHOWN_FRAMES, len(ids))).astype(int)})
    source = str(labels.info.get("source", ""))
    title = source or labels.path.name
    seen = [labels.read(frame_id) for frame_id in chosen]
    frames = [make_shown_frame(frame, partial(clouds.picture, source, frame)) for frame in seen]
    scenes = [
        make_scene(f"{title} · {f.frame_id}", f, camera_of(labels, f), None, clouds.of(source, f))
        for f in seen[:1]
    ]
    return ShownSet(title, frames, [scene for scene in scenes if scene is not None], note)

"""Content of a report, gathered from files. Constants are untuned."""

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
from annotate.scheme.scheme import Scheme
from eval.compare.common_scheme import common_scheme
from eval.compare.difference import Difference, difference
from eval.compare.pairs import load_pair, pair_up
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

SHOWN_FRAMES = 12  # of a label set without a truth, evenly spread
SCENES = 12  # of all results together, 0.2 MB each


@dataclass(frozen=True)
class ShownSet:
    """Labels of frames without a truth, shown but not scored."""

    title: str
    scheme: Scheme
    frames: Sequence[GalleryFrame]
    scenes: Sequence[Scene] = ()
    note: str = ""


@dataclass(frozen=True)
class Sources:
    """Inputs of a report.

    results: the first is the baseline. ceiling: one person's corrections against another's. sessions:
    recordings of the labels. trainings: folders of `train`. audited: corrected label sets. shown: label sets
    without a truth, each with a note. facts: command, seed, hashes. each: number of
    frames in a group of the gallery.
    """

    results: Sequence[Result]
    ceiling: Result | None = None
    sessions: Sequence[Session] = ()
    trainings: Sequence[Path] = ()
    audited: Sequence[Path] = ()
    shown: Mapping[Path, str] = field(default_factory=dict)
    facts: Mapping[str, str] = field(default_factory=dict)
    each: int = EACH


@dataclass(frozen=True)
class Material:
    """Content of a report, see ``Sources``. galleries: frames by title of the result. audits: work on
    corrected label sets, by set.

    Raises CloudError without results, or for two results of one title.
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
            raise CloudError("the report has 0 results; give at least one that evaluate wrote")
        titles = [result.title for result in self.results]
        twice = next((title for title in titles if titles.count(title) > 1), None)
        if twice is not None:
            raise CloudError(f"two results have the title {twice!r}; evaluate one again with another --title")

    @cached_property
    def schemes(self) -> tuple[Scheme, ...]:
        """Different schemes of the results, the baseline's first."""
        return tuple(dict.fromkeys(result.comparison.scheme for result in self.results))

    @cached_property
    def differences(self) -> list[Difference]:
        """Every result but the first, minus the first."""
        return [difference(result, self.results[0]) for result in self.results[1:]]


class Clouds:
    """Fused clouds of recorded sessions, by session name and frame id."""

    def __init__(self, sessions: Sequence[Session]) -> None:
        self._fusers = {session.name: (session, Fuser(session.calibration)) for session in sessions}

    def of(self, source: str, frame: FrameLabels) -> ThermalCloud | None:
        """Return the cloud of a frame labelled from ``source``; None if no session has its depth image."""
        if source not in self._fusers or not frame.frame_id.isascii() or not frame.frame_id.isdigit():
            return None
        session, fuser = self._fusers[source]
        if int(frame.frame_id) >= len(session):
            return None
        cloud = fuser.fuse_frame(session.frame(int(frame.frame_id)))
        return cloud if np.array_equal(cloud.depth_mm, frame.depth_mm) else None

    def image(self, source: str, frame: FrameLabels, person: Bool, crop: Crop) -> Image | None:
        """Return the image of a frame's cloud; None without a cloud."""
        cloud = self.of(source, frame)
        return None if cloud is None else cloud_picture(cloud, person, crop)


def gather(sources: Sources) -> Material:
    """Return the content of a report.

    A result whose label sets were moved has no images. Raises FormatError for a corrupt file, CloudError for
    labels that changed after the evaluation.
    """
    clouds = Clouds(sources.sessions)
    galleries: dict[str, list[GalleryFrame]] = {}
    scenes: list[Scene] = []
    for result in sources.results:
        galleries[result.title], own = pictures_of(result, clouds, sources.each)
        scenes += own[: max(1, SCENES // len(sources.results))]
    shown_sets = [shown_set(LabelSet.open(path), note, clouds) for path, note in sources.shown.items()]
    return Material(
        results=tuple(sources.results),
        ceiling=sources.ceiling,
        galleries=galleries,
        scenes=[*scenes, *(scene for one in shown_sets for scene in one.scenes)],
        trainings=[load_training(folder) for folder in sources.trainings],
        audits={path.name: _audit(path) for path in sources.audited},
        shown=shown_sets,
        facts=sources.facts,
    )


def _audit(path: Path) -> Audit:
    labels = LabelSet.open(path)
    return audit(labels, Journal.of(path, labels.scheme))


def pictures_of(result: Result, clouds: Clouds, each: int) -> tuple[list[GalleryFrame], list[Scene]]:
    """Return a result's gallery, and a scene of the first frame of each group; none if the label sets were
    moved.

    Raises FormatError for label sets that do not convert to the result's scheme.
    """
    sets = [Path(result.facts[name]) for name in ("predicted", "truth") if name in result.facts]
    if len(sets) < 2 or not all(holds_frames(path) for path in sets):
        return [], []
    predicted, truth = (open_frames(path) for path in sets)
    source = str(truth.info.get("source", ""))
    common = common_scheme(predicted.scheme, truth.scheme, result.comparison.scheme)
    pairs = {pair.truth.frame_id: pair for pair in pair_up(predicted, truth)[0]}
    scores = dict(zip(result.comparison.frame_ids, result.comparison.frame_miou, strict=True))
    frames, scenes = [], []
    for group, frame_ids in pick_frames(result.comparison, each).items():
        for place, frame_id in enumerate(frame_ids):
            pair = pairs.get(frame_id) or _changed(result, frame_id, sets)
            guess, target = load_pair((predicted, truth), pair, common)
            frames.append(make_frame(target, guess, partial(clouds.image, source, target), group))
            if not np.isclose(frames[-1].miou, scores[frame_id], rtol=0, atol=1e-9):
                _changed(result, frame_id, sets)
            if not place:
                title = f"{result.title} · {group.lower()} · {frame_id}"
                cloud = clouds.of(source, target)
                scenes.append(make_scene(title, guess, camera_of(truth, target), target, cloud))
    return frames, [scene for scene in scenes if scene is not None]


def _changed(result: Result, frame_id: str, sets: Sequence[Path]) -> NoReturn:
    raise CloudError(
        f"frame {frame_id} of {sets[0]} or {sets[1]} has changed since {result.title!r} was measured; "
        "evaluate again"
    )


def shown_set(labels: LabelSet, note: str, clouds: Clouds) -> ShownSet:
    """Return evenly spread frames of a label set, and the first as a scene."""
    ids = labels.frame_ids
    chosen = sorted({ids[i] for i in np.linspace(0, len(ids) - 1, min(SHOWN_FRAMES, len(ids))).astype(int)})
    source = str(labels.info.get("source", ""))
    title = source or labels.path.name
    seen = [labels.read(frame_id) for frame_id in chosen]
    frames = [make_shown_frame(frame, partial(clouds.image, source, frame)) for frame in seen]
    scenes = [
        make_scene(f"{title} · {f.frame_id}", f, camera_of(labels, f), None, clouds.of(source, f))
        for f in seen[:1]
    ]
    return ShownSet(title, labels.scheme, frames, [scene for scene in scenes if scene is not None], note)

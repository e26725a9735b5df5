"""Ablation of the suit network's inputs: an input that is left out has no effect on labels."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from annotate.cloud.fuse import Fuser
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.label_recording import SuitLabeller, label_source
from annotate.parts import N_CLASSES
from annotate.person import extract
from annotate.person.detection.finder import find_people
from annotate.person.planes import Plane
from annotate.segmentation.input_channels import CHANNELS
from annotate.segmentation.labels_of_frame import labels_of
from annotate.suit.palette import DEFAULT_SUIT, Suit
from sensors.session.reader import Session
from synth.appearance.random_suit import random_suit
from tools.figures.figure import Figure
from tools.figures.inputs import COLUMNS, SUBJECTS, conclusion, worth
from tools.measure import ablation
from tools.measure.ablation import (
    CHANNELS_CUT,
    COLOR,
    CUTS,
    SECONDS,
    SUIT,
    Cut,
    LabellerWithout,
    label_without,
    labelled,
    row,
)

WHOLE = ("suit", "color", "temperature", "planes", "before")


@pytest.fixture(scope="module")
def clouds(rig_session) -> list[ThermalCloud]:
    """Return the clouds of two frames of one person."""
    session = Session(rig_session)
    fuser = Fuser(session.calibration)
    return [fuser.fuse_frame(frame) for frame in list(session)[:2]]


@dataclass(frozen=True)
class World:
    """Data of two frames that a test changes."""

    clouds: list[ThermalCloud]
    suit: Suit = DEFAULT_SUIT
    spoil: Callable[[FrameLabels], FrameLabels] = lambda labels: labels


def images(world: World, cut: Cut) -> list[np.ndarray]:
    """Return parts, confidence and persons of the frames, labelled one after another without a cut."""
    labeller, before, made = LabellerWithout(world.suit, cut), None, []
    for cloud in world.clouds:
        found, person = labeller.label(labeller.detect(cloud), before)
        before = world.spoil(labels_of("0", cloud.depth_mm, found, person))
        made += [found.parts, found.confidence, person.persons]
    return made


def equal(a: list[np.ndarray], b: list[np.ndarray]) -> bool:
    return all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def changed(name: str, world: World, monkeypatch) -> World:
    """Return a world in which one input holds other data."""
    rng, clouds = np.random.default_rng(1), world.clouds
    if name == "suit":
        return replace(world, suit=random_suit(11))
    if name == "color":
        rgb = [rng.integers(0, 256, one.color_rgb.shape, np.uint8) for one in clouds]
        seen = [rng.random(one.depth_mm.shape) < 0.5 for one in clouds]
        news = zip(clouds, rgb, seen, strict=True)
        return World([replace(one, color_rgb=c, color_valid=v) for one, c, v in news], random_suit(11))
    if name == "temperature":
        hot = [rng.uniform(5, 45, one.depth_mm.shape).astype(np.float32) for one in clouds]
        for celsius in hot:
            celsius[:, ::7] = np.nan
        return World([replace(one, temperature_c=c) for one, c in zip(clouds, hot, strict=True)])
    if name == "planes":
        ray = np.array([0, 0, -1], np.float32)
        wild = tuple(Plane(ray, -0.1 * far, 3.0) for far in range(5, 60))
        monkeypatch.setattr(extract, "find_planes", lambda cloud: wild)
        return world

    def spoil(labels: FrameLabels) -> FrameLabels:
        parts = rng.integers(0, N_CLASSES, labels.parts.shape, np.uint8)
        notes = labels.notes | {"light": [1.0, -1.0], "people": [[9, 0, 0, 0]]}
        return replace(labels, parts=parts, persons=(parts > 3).astype(np.uint8), notes=notes)

    return replace(world, spoil=spoil)


@pytest.mark.parametrize("name", WHOLE)
def test_labels_do_not_depend_on_an_input_that_is_cut_but_do_on_one_that_is_not(name, clouds, monkeypatch):
    world, cuts = World(clouds), [cut for cut in CUTS.values() if name in cut.inputs]
    assert cuts
    before = [images(world, cut) for cut in (Cut(), *cuts)]
    other = changed(name, world, monkeypatch)
    after = [images(other, cut) for cut in (Cut(), *cuts)]
    assert [equal(*pair) for pair in zip(before, after, strict=True)] == [False] + [True] * len(cuts)


def test_without_colour_labels_do_not_depend_on_the_suit(clouds):
    assert equal(images(World(clouds), CUTS[COLOR]), images(World(clouds, random_suit(11)), CUTS[COLOR]))


def test_the_subject_of_two_persons_is_chosen_without_the_suit_that_is_cut(clouds, monkeypatch):
    def find_halves(cloud, warmth):
        (person,) = find_people(cloud, warmth)
        top, end = np.flatnonzero(person.mask.any(axis=1))[[0, -1]]
        upper = np.arange(len(person.mask))[:, None] < (top + end) // 2
        return [replace(person, mask=person.mask & side) for side in (upper, ~upper)]

    asked = []
    monkeypatch.setattr(extract, "find_people", find_halves)
    monkeypatch.setattr(extract, "cloths_shown", lambda suit, cloud, mask: asked.append(suit) or 1.0)
    images(World(clouds), CUTS[SUIT])
    images(World(clouds), CUTS[COLOR])
    assert not asked
    images(World(clouds), Cut())
    assert asked


def test_the_conclusion_lists_the_changes_beyond_chance_alone():
    lost, kept = Figure(-0.04, -0.06, -0.02), Figure(0.5, -0.1, 1.1)
    heads = COLUMNS.keys()
    assert worth(dict.fromkeys(heads, lost), "hard") == "0.040 of mean recall, -0.0 s a frame"
    slower = dict.fromkeys(heads, kept) | {f"{SECONDS}, `hard`": Figure(2.0, 1.0, 3.0)}
    assert worth(slower, "hard") == "2.0 s a frame"
    assert worth(slower, "normal") == "nothing beyond chance"
    said = conclusion({name: dict.fromkeys(heads, lost) for name in SUBJECTS})
    assert len(said.splitlines()) == len(SUBJECTS)


def test_labels_without_a_cut_are_those_of_label(clouds, rig_session, rig_labels, tmp_path):
    session, frames = Session(rig_session), rig_labels.frame_ids
    for cut, labeller in (
        (Cut(), SuitLabeller(DEFAULT_SUIT)),
        (Cut(window_c=(25.0, 35.0)), SuitLabeller(DEFAULT_SUIT, window_c=(25.0, 35.0))),
    ):
        out = tmp_path / str(len(list(tmp_path.iterdir())))
        theirs = label_source(session, labeller, out / "label", lambda n: None).labels
        ours = label_without(rig_session, cut)(session, out / "cut").labels
        for one, other in zip(map(theirs.read, frames), map(ours.read, frames), strict=True):
            assert equal([one.parts, one.persons], [other.parts, other.persons]) and one.notes == other.notes


@pytest.mark.parametrize("name", [name for name, cut in CHANNELS_CUT.items() if not cut.window_c])
def test_labels_do_not_depend_on_a_channel_that_is_cut(name, clouds, monkeypatch):
    silence, rng = CHANNELS_CUT[name].silence, np.random.default_rng(2)
    whole = images(World(clouds), CHANNELS_CUT[name])
    silenced = ablation.Silence.over

    def wild(own, planes):
        other = planes.copy()
        for channel in silence.channels:
            other[CHANNELS.index(channel)] = rng.integers(0, 256, planes.shape[1:], np.uint8)
        if silence.flags:
            other[0] ^= rng.integers(0, 256, planes.shape[1:], np.uint8) & np.uint8(silence.flags)
        return silenced(own, other)

    monkeypatch.setattr(ablation.Silence, "over", wild)
    assert equal(whole, images(World(clouds), CHANNELS_CUT[name]))
    assert not equal(whole, images(World(clouds), Cut()))


def test_every_channel_has_a_row():
    own = {channel for cut in CHANNELS_CUT.values() for channel in cut.silence.channels}
    by_input = {"flags", "before", "off_plane", "share", "celsius"}
    assert own | by_input | set(CHANNELS[-13:]) == set(CHANNELS) and not own & by_input


def test_without_a_difference_the_interval_of_a_row_is_empty(rig_session):
    whole = labelled(rig_session, label_without(rig_session, Cut()))
    cells = row("nothing", whole, whole).strip("| ").split(" | ")
    assert cells[0] == "nothing" and len(cells) == 5
    assert all(cell.endswith("]") and "+0.0" in cell for cell in cells[1:])
    assert len(whole.seconds) == 2  # the last frame of each person

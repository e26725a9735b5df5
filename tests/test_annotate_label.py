"""The labelling run keeps what it can, resumes to the bit, and mixes nothing."""

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import tree

from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.frame_labels import FrameLabels
from annotate.label_recording import SuitLabeller, label_source, run
from annotate.labelset.label_set import LabelSet
from annotate.parts import UNDEFINED
from annotate.person.extract import PersonMask
from annotate.segmentation.segmented_person import Segmentation, unlabelled
from annotate.suit.palette import DEFAULT_SUIT
from sensors.errors import CloudError, ExistsError
from sensors.rig.frame import FrameSource, RigFrame
from sensors.rig.rig_calibration import Pose, RigCalibration
from sensors.session.reader import Session
from tests.helpers.labellers import CloudLabeller


class Altered(FrameSource):
    """A recording with every frame changed: ``change`` returns a frame, or raises."""

    def __init__(
        self, session: Session, change=lambda frame: frame, calibration: RigCalibration | None = None
    ):
        self._session, self._change = session, change
        self.name, self.times_ns, self.subject = session.name, session.times_ns, session.subject
        self.calibration = calibration or session.calibration

    def _frame(self, index: int) -> RigFrame:
        return self._change(self._session.frame(index))


def silent(n: int) -> None:
    assert n == 1


@pytest.fixture
def session(rig_session) -> Session:
    return Session(rig_session)


@pytest.fixture
def labelled(tmp_path, rig_labels) -> Path:
    """Copy of the labelled session with its file times."""
    return Path(shutil.copytree(rig_labels.path, tmp_path / "l"))


def broken_color(at: set[int]):
    return lambda f: replace(f, color_encoded=b"\xff\xd8") if f.index in at else f


def test_every_frame_is_labelled_and_kept(session, rig_labels):
    assert rig_labels.frame_ids == ["000000", "000001", "000002"]
    for frame in rig_labels:
        assert frame.status == "auto"
        assert len(np.unique(frame.parts)) >= 10
        assert not (frame.parts[frame.depth_mm == 0]).any()
        assert frame.notes["extraction"] == "thermal"
        on = frame.parts > 0
        assert frame.notes["confidence"] == pytest.approx(float(frame.confidence[on].mean()), abs=0.005)
    assert rig_labels.info["source"] == session.name
    assert rig_labels.info["steps"]["label"]["suit"].startswith("name = ")


def test_without_a_suit_only_the_person_is_found(tmp_path, session, rig_labels):
    run = label_source(session, SuitLabeller(None), tmp_path / "l", silent)
    for bare, dressed in zip(run.labels, rig_labels, strict=True):
        assert set(np.unique(bare.parts)) == {0, UNDEFINED}
        # The suit's reader finds a little of the body that its warmth does not, and drops what lies loose.
        found, worn = bare.parts > 0, dressed.parts > 0
        assert (found & worn).sum() > 0.92 * (found | worn).sum()


@pytest.mark.parametrize("stops_at", [0, 1, 2])
def test_a_run_that_broke_off_goes_on_to_the_same_bytes(tmp_path, session, rig_labels, stops_at, monkeypatch):
    def stop(self: Session, index: int) -> RigFrame:
        if index == stops_at:
            raise KeyboardInterrupt
        return whole(self, index)

    out, whole = tmp_path / "l", Session.frame
    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(Session, "frame", stop)
        label_source(session, SuitLabeller(DEFAULT_SUIT), out, silent)
    assert len(LabelSet.open(out)) == stops_at
    label_source(session, SuitLabeller(DEFAULT_SUIT), out, silent)
    assert tree(out) == tree(rig_labels.path)


def test_what_is_done_is_not_done_again(session, labelled):
    files = {p: p.stat().st_mtime_ns for p in labelled.rglob("*")}
    label_source(session, SuitLabeller(DEFAULT_SUIT), labelled, silent)
    assert {p: p.stat().st_mtime_ns for p in labelled.rglob("*")} == files


def test_other_settings_or_another_recording_are_refused(session, labelled):
    before = tree(labelled)
    other = Altered(session, lambda f: replace(f, depth_mm=np.roll(f.depth_mm, 5, axis=0)))
    for source, suit, window in (
        (session, None, None),
        (session, DEFAULT_SUIT, (24.0, 35.0)),
        (other, DEFAULT_SUIT, None),
    ):
        with pytest.raises(ExistsError, match="choose another folder"):
            label_source(source, SuitLabeller(suit, None, window), labelled, silent)
        assert tree(labelled) == before


def test_a_corrupt_frame_blocks_resuming_and_is_left_alone(session, labelled):
    spoilt = labelled / "frames" / "000001.depth.png"
    spoilt.write_bytes(spoilt.read_bytes()[:900])
    before = tree(labelled)
    with pytest.raises(CloudError, match=r"000001\.depth\.png"):
        label_source(session, SuitLabeller(DEFAULT_SUIT), labelled, silent)
    assert tree(labelled) == before


def stripes(shape: tuple[int, int], trusted: bool = True) -> PersonMask:
    """A person in the upper third of the image, another one in the lower third."""
    rows = np.broadcast_to(np.arange(shape[0])[:, None] * 3 // shape[0], shape)
    whose = np.select([rows == 0, rows == 2], [1, 2], 0).astype(np.uint8)
    return PersonMask(rows == 0, "thermal", whose, () if trusted else ("thermal: off",), trusted)


def test_every_frame_is_given_the_one_before_as_it_is_stored(tmp_path, session):
    seen = []

    def one(cloud: ThermalCloud, before: FrameLabels | None) -> tuple[Segmentation, PersonMask]:
        seen.append(before)
        person = stripes(cloud.valid.shape)
        sure = np.random.default_rng(len(seen)).random(cloud.valid.shape).astype(np.float32)
        return replace(unlabelled(person.mask), confidence=sure), person

    labels = run(Altered(session, broken_color({1})), {}, tmp_path / "l", CloudLabeller(one), silent).labels
    assert seen == [None, None]  # at first, and after a frame that failed
    kept = run(session, {}, tmp_path / "m", CloudLabeller(one), silent).labels
    assert seen[2] is None
    for before, frame_id in zip(seen[3:], kept.frame_ids, strict=False):
        stored = kept.read(frame_id)
        for name in ("depth_mm", "parts", "confidence", "persons"):
            np.testing.assert_array_equal(getattr(before, name), getattr(stored, name))
        assert before.notes == stored.notes
    assert set(np.unique(labels.read("000000").persons)) == {0, 1, 2}


def test_a_frame_that_cannot_be_relied_on_is_not_labelled(tmp_path, session, monkeypatch):
    monkeypatch.setattr(
        "annotate.label_recording.PersonDetection.person",
        lambda survey, before: stripes(survey.cloud.depth_mm.shape, False),
    )
    for frame in label_source(session, SuitLabeller(DEFAULT_SUIT), tmp_path / "l", silent).labels:
        np.testing.assert_array_equal(frame.parts == UNDEFINED, frame.persons == 1)
        assert not frame.confidence.any()
        assert frame.notes["notes"] == ["thermal: off"]


@pytest.mark.parametrize("bad", [{1}, {0, 1, 2}])
def test_failed_frames_are_counted_and_a_set_without_frames_is_removed(tmp_path, session, bad):
    told, source = [], Altered(session, broken_color(bad))
    if len(bad) == 3:
        with pytest.raises(CloudError, match="none of the 3 frames could be labelled; frame 000000: colour"):
            label_source(source, SuitLabeller(DEFAULT_SUIT), tmp_path / "l", told.append)
        assert not list(tmp_path.iterdir())
    else:
        run = label_source(source, SuitLabeller(DEFAULT_SUIT), tmp_path / "l", told.append)
        assert [frame_id for frame_id, _ in run.failed] == ["000001"]
        assert run.labels.frame_ids == ["000000", "000002"]
    assert told == [1, 1, 1]


def test_images_of_uncalibrated_cameras_are_left_out_and_noted(tmp_path, session):
    depth_only = Altered(session, calibration=RigCalibration(session.calibration.depth))
    run = label_source(depth_only, SuitLabeller(DEFAULT_SUIT), tmp_path / "l", silent)
    assert not run.failed and {frame.notes["extraction"] for frame in run.labels} == {"depth"}
    assert {"colour left out: its camera is not calibrated"} < set(run.remarks())


def exposed(gain: float):
    def change(frame: RigFrame) -> RigFrame:
        rgb = cv2.imdecode(np.frombuffer(frame.color_encoded, np.uint8), cv2.IMREAD_COLOR)
        bent = np.clip(rgb.astype(np.float32) * gain, 0, 255).astype(np.uint8)
        return replace(frame, color_encoded=bytes(cv2.imencode(".jpg", bent)[1]))

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda f: replace(f, thermal_c=np.full_like(f.thermal_c, 20.0)),
            ("no person", "step into the view"),
        ),
        (lambda f: replace(f, depth_mm=np.zeros_like(f.depth_mm)), ("no person",)),
        (exposed(40.0), ("colour is over-exposed", "lower the colour camera's exposure")),
        (exposed(0.04), ("colour is too dark", "light the room")),
    ],
    ids=["cold", "empty", "bright", "dark"],
)
def test_a_bad_frame_is_noted_its_parts_stay_undefined_and_its_review_comes_first(
    tmp_path, session, change, said
):
    source = Altered(session, lambda frame: change(frame) if frame.index == 1 else frame)
    done = label_source(source, SuitLabeller(DEFAULT_SUIT), tmp_path / "l", silent)
    notes = [note for note, frames in done.remarks().items() if frames == ["000001"]]
    assert any(all(word in note for word in said) for note in notes), done.remarks()
    frame = done.labels.read("000001")
    assert set(np.unique(frame.parts)) <= {0, UNDEFINED} and not frame.confidence.any()
    assert done.review_order()[0] == "000001" and len(np.unique(done.labels.read("000002").parts)) >= 10


@pytest.mark.parametrize("axis", [0, 1])
def test_a_thermal_camera_3_degrees_off_is_detected(tmp_path, session, axis):
    turn, pose = cv2.Rodrigues(np.radians(3.0) * np.eye(3)[axis])[0], session.calibration.thermal_from_depth
    off = Pose(turn @ pose.rotation, turn @ np.asarray(pose.translation_m))
    source = Altered(session, calibration=replace(session.calibration, thermal_from_depth=off))
    done = label_source(source, SuitLabeller(DEFAULT_SUIT), tmp_path / "l", silent)
    frames = {i for note, ids in done.remarks().items() if "calibrate the thermal" in note for i in ids}
    assert len(frames) >= 2
    for frame in done.labels:
        assert frame.frame_id not in frames or set(np.unique(frame.parts)) <= {0, UNDEFINED}

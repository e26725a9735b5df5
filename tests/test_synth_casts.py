"""Casts: the judging cast shares nothing with the training cast, and no training accepts or reaches it."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from conftest import assert_refused

from annotate.labelset.dataset import Dataset
from annotate.labelset.label_set import LabelSet
from annotate.suit.palette import DEFAULT_SUIT
from eval.fine_tuning.training_split import FOLDS, CorrectedFrame, folds
from eval.training.crops import load_crops
from eval.training.rooms.scenes import room_scenes
from eval.training.segmentation import scenes
from eval.training.segmentation.scenes import FIRST_SUIT, training_rig
from eval.training.shared_bodies import BODIES, HELD_OUT, bodies_in
from sensors.errors import CloudError
from sensors.session.reader import Session
from synth import data_files
from synth.appearance.random_suit import judge_suits, random_suit, suit_of
from synth.body.body import shipped_bodies
from synth.body.crowd import crowd, crowd_of, judge_bodies, suit_wearers
from synth.clothes.attire import draw_attire
from synth.data_files import JUDGE, TRAINING, table_of
from synth.images import people
from synth.images.generate import Order
from synth.images.presets import JUDGE_PRESETS, PRESETS, blended_bodies, preset_named, sample
from synth.pose.pose_parameters import posture_class
from synth.pose.postures import poses_of
from synth.pose.standing_parameters import draw_standing
from synth.rig import episode
from synth.rig.locations import SCENES, located
from synth.rig.virtual_rig import RigOptions, VirtualRig
from synth.surface.furniture import Bed, Chair, Sofa
from synth.surface.judge_furniture import OWN
from synth.surface.room import PLAIN_ROOM, draw_room
from tests.helpers.label_sets import CAMERA, blocks, make
from tools.fit.crowd import AGE_YEARS, JUDGE_AGE_YEARS, judge_sketches, sketches
from tools.fit.suit_network import check_inputs

APART_M = 0.003  # least mean distance of two bodies' skins: beyond the noise of a depth camera


@cache
def judged(name):
    """Frames of a preset with the judging cast."""
    return [sample(JUDGE_PRESETS[name], 3, i * 48) for i in range(4)]


def test_bodies_of_the_judging_cast_are_many_and_like_no_other():
    known, bmi = [*crowd(), *shipped_bodies()], []
    for body in judge_bodies():
        away = [np.linalg.norm(body.vertices_m - other.vertices_m, axis=1).mean() for other in known]
        assert min(away) > APART_M and body.name not in {other.name for other in known}
        bmi.append(body.weight_kg / (body.height_cm / 100) ** 2)
    assert len(judge_bodies()) >= 12 and min(bmi) < 18 and max(bmi) > 37
    genders = [sketch.gender for sketch in judge_sketches()]
    assert sum(gender > 0.5 for gender in genders) == len(genders) / 2
    assert JUDGE_AGE_YEARS == (18, 85) and AGE_YEARS == (16, 80)
    assert not {*judge_sketches()} & {*sketches()}
    assert Path(data_files.shipped("judge", "bodies.npz")).stat().st_size < 1_500_000
    for of in (crowd_of, suit_wearers):
        assert not {body.name for body in of(JUDGE)} & {body.name for body in of(TRAINING)}


def test_suits_of_the_judging_cast_are_worn_in_no_training():
    worn = [DEFAULT_SUIT, *(random_suit(FIRST_SUIT + number) for number in range(400))]
    known = {suit.colors_rgb.tobytes() for suit in worn}
    own = {suit_of(JUDGE, seed).colors_rgb.tobytes() for seed in range(8)}
    drawn = {random_suit(seed, JUDGE).colors_rgb.tobytes() for seed in range(100)}
    assert len(own) == len(judge_suits()) == 4 and not (own | drawn) & known
    assert not any(suit.look_alikes for suit in judge_suits())
    assert suit_of(TRAINING, 5) is DEFAULT_SUIT


def test_furniture_and_rooms_of_the_judging_cast_are_others():
    rng, ranges = np.random.default_rng(0), table_of(TRAINING, "furniture")
    for kind in OWN:
        base = next(base for base in (Sofa, Chair, Bed) if issubclass(kind, base))
        drawn = kind.sample(rng)
        shapes = [[(solid.low, solid.high) for solid in one.solids()] for one in (drawn, base.sample(rng))]
        assert shapes[0] != shapes[1] and len(shapes[0]) > 3
        own = table_of(JUDGE, "furniture")[kind.__name__.lower()]
        assert all(own.get(name) != span for name, span in ranges[base.__name__.lower()].items())
        with_side = [replace(drawn, side=sign) for sign in (-1.0, 1.0)] if "side" in own else [drawn]
        for one in with_side:
            low = np.min([solid.mesh().vertices_m.min(axis=0) for solid in one.solids()], axis=0)
            assert low[2] > -1e-6 and one.mesh().faces.max() < len(one.mesh().vertices_m)
    for seed in range(50):
        room = draw_room(JUDGE, np.random.default_rng(seed))
        for name in ("left_x", "right_x", "front_y", "height"):
            assert abs(getattr(room, name) - getattr(PLAIN_ROOM, name)) > 0.05
    assert draw_room(TRAINING, rng) is PLAIN_ROOM


def test_poses_clothes_and_colours_of_the_casts_have_no_entry_in_common():
    for own, other in zip(poses_of(JUDGE), poses_of(TRAINING), strict=True):
        assert own.activities and not own.activities.keys() & other.activities.keys()
        assert not any(spreads in other.activities.values() for spreads in own.activities.values() if spreads)
        assert own.base != other.base
    for file, tables in (
        ("poses/standing", ("stances", "hands", "arms")),
        ("clothes", ("styles", "tops", "trousers", "skirts", "shoes", "hair")),
    ):
        for name in tables:
            own, other = table_of(JUDGE, file)[name], table_of(TRAINING, file)[name]
            assert own and not own.keys() & other.keys()
            assert not any(entry in other.values() for entry in own.values())
    for file in ("people", "surfaces"):
        for name, own in table_of(JUDGE, file).items():
            other = table_of(TRAINING, file)[name]
            for key in ("rgb", "often") if isinstance(own, dict) else ("",):
                listed = [own.get(key, []), other.get(key, [])] if key else [own, other]
                assert not {str(rgb) for rgb in listed[0]} & {str(rgb) for rgb in listed[1]} or key == "rgb"
                assert listed[0] != listed[1] or not listed[0]


def test_activities_of_the_judging_cast_have_a_posture():
    poses = poses_of(JUDGE)
    assert {posture_class(name) for name in poses.sitting.activities} == {"sitting"}
    assert {posture_class(name) for name in (*poses.in_bed.activities, *poses.fallen.activities)} == {"lying"}
    assert {posture_class(name) for name in table_of(JUDGE, "poses/standing")["stances"]} == {"standing"}
    upright = {posture_class(name) for name in poses.upright.activities}
    assert upright == {"standing", "crouching", "kneeling", "on all fours", None}


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_images_of_the_judging_cast_show_its_people_alone(name):
    poses, bodies = poses_of(JUDGE), {body.name for body in judge_bodies()}
    known = {activity for family in poses for activity in family.activities}
    known |= table_of(JUDGE, "poses/standing")["stances"].keys()
    garments = {
        entry
        for kind in ("tops", "trousers", "skirts", "shoes", "hair")
        for entry in table_of(JUDGE, "clothes")[kind]
    }
    for i, frame in enumerate(judged(name)):
        assert frame.subject in bodies and frame.notes["activity"] in known
        assert set(frame.notes.get("clothes", ())) <= garments | {"backpack", "shoulder_bag"}
        assert blended_bodies(name, JUDGE, 3, i * 48)[0] == frame.subject
    streams = {preset.stream for preset in (*PRESETS.values(), *JUDGE_PRESETS.values())}
    assert len(streams) == 2 * len(PRESETS)


@pytest.mark.parametrize("scene", sorted(SCENES))
def test_a_rig_of_the_judging_cast_records_its_people(scene):
    rig = VirtualRig(1, 1, "normal", 3, RigOptions(scene, draft=True, cast=JUDGE))
    ((_, known),) = rig.with_truth()
    assert rig.name == f"virtual-judge-{scene}-normal-3" and rig.suit is suit_of(JUDGE, 3)
    assert set(known.bodies) <= {body.name for body in judge_bodies()}
    assert known.bodies == episode.blended_bodies(JUDGE, 3, 0)
    assert np.count_nonzero((known.regions > 0) & (known.regions < 25)) > 500
    place = located(scene, JUDGE)(np.random.default_rng(1))
    assert place.room != PLAIN_ROOM and (type(place.furniture) in OWN or scene == "floor")


def test_training_reads_no_data_of_the_judging_cast(monkeypatch):
    """All generators of training data, with the judging cast's files out of reach."""
    posture_class("standing")  # lists the names of all activities, once
    opened = data_files.shipped

    def guarded(*names: str) -> Path:
        assert not any("judge" in name for name in names), names
        return opened(*names)

    def table(name: str):
        assert "judge" not in name
        return loaded(name)

    loaded = data_files.table
    monkeypatch.setattr(data_files, "shipped", guarded)
    monkeypatch.setattr(data_files, "table", table)
    for module in ("synth.body.crowd", "synth.appearance.random_suit", "synth.body.body"):
        monkeypatch.setattr(f"{module}.shipped", guarded)
    for name in ("judge_bodies", "judge_suits"):
        where = {"judge_bodies": "synth.body.crowd", "judge_suits": "synth.appearance.random_suit"}[name]
        monkeypatch.setattr(f"{where}.{name}", lambda: pytest.fail("judging cast reached"))
    for kind in OWN:
        monkeypatch.setattr(kind, "sample", lambda rng: pytest.fail("judging cast reached"))
    for number in range(6):
        rig = training_rig(number, held_out=number % 2 == 1)
        assert rig.cast == TRAINING
        made = episode.Episode(rig._setup, number)
        next(made.states())
    for preset in PRESETS.values():
        assert preset.cast == TRAINING and sample(preset, 8, 0).subject.startswith(("body", "crowd"))
    next(room_scenes(5))


def test_sources_of_training_do_not_name_the_judging_cast():
    root = Path(scenes.__file__).parents[3]
    allowed = {"eval/training/shared_bodies.py", "tools/fit/crowd.py"}
    files = [file for folder in ("eval", "tools/fit") for file in (root / folder).rglob("*.py")]
    naming = {
        file.relative_to(root).as_posix()
        for file in files
        if "JUDGE" in (text := file.read_text()) or '"judge' in text
    }
    assert naming <= allowed and len(files) > 50


def test_the_held_out_bodies_of_the_fitting_tools_are_not_trained_on():
    learnt, held = (scenes.wearers(held_out) for held_out in (False, True))
    assert not {body.name for body in learnt} & {body.name for body in held}
    assert len(learnt) + len(held) == len(suit_wearers(TRAINING)) and len(held) == 2
    assert {body.name for body in held} < HELD_OUT and len(HELD_OUT & {body.name for body in crowd()}) == 3
    for number in range(4):
        made = episode.Episode(training_rig(11, held_out=True)._setup, number)
        assert made.bodies and set(made.bodies) <= HELD_OUT


@pytest.mark.parametrize("name", ["people", "recumbent"])
@pytest.mark.parametrize("cast", [TRAINING, JUDGE])
def test_the_bodies_of_an_image_are_drawn_again(name, cast):
    preset = preset_named(name, cast)
    for number in range(5):
        rng = np.random.default_rng((preset.stream, 9, number, 1))
        bodies = crowd_of(cast) if name == "people" else suit_wearers(cast)
        body, _ = people._between(bodies, rng)
        first, second = blended_bodies(name, cast, 9, number * preset.each)
        one, other = (next(b for b in bodies if b.name == who) for who in (first, second))
        way = (other.vertices_m - one.vertices_m).ravel().astype(np.float64)
        off = (body.vertices_m - one.vertices_m).ravel().astype(np.float64)
        share = off @ way / (way @ way)
        assert body.name == first and 0 <= share <= 0.5
        assert np.abs(off - share * way).max() < 1e-5
    assert blended_bodies("unheard-of", cast, 9, 0) is None


def test_a_dataset_names_its_cast_and_only_measures(annotate_cloud, tmp_path):
    data = tmp_path / "judge"
    command = ("synth", "generate", "--preset", "standing", "--count", 2, "--workers", 1, "--out", data)
    assert annotate_cloud(*command, "--cast", "judge").code == 0
    assert Dataset.open(data).info["cast"] == "judge"
    assert "cast" not in Order(PRESETS["standing"], 1, 0).manifest()
    assert "<h1>standing, cast judge</h1>" in (data / "index.html").read_text()
    for frame in Dataset.open(data):
        assert bodies_in(Dataset.open(data), frame) == set(blended_bodies("standing", JUDGE, 0, 0))
    done = annotate_cloud("train", data, "--out", tmp_path / "run")
    assert_refused(done, data, "reserved for measuring")
    with pytest.raises(SystemExit) as ended:
        check_inputs([data])
    assert "\n" not in str(ended.value) and "judge" in str(ended.value)
    predicted = tmp_path / "predicted"
    assert annotate_cloud("predict", data, "--out", predicted).code == 0
    assert_refused(
        annotate_cloud("train", predicted, "--out", tmp_path / "run"), predicted, "reserved for measuring"
    )
    exported, read = tmp_path / "exported", tmp_path / "read"
    assert annotate_cloud("export", predicted, exported, "--format", "mmseg").code == 0
    assert annotate_cloud("import", exported, read).code == 0
    assert_refused(annotate_cloud("train", read, "--out", tmp_path / "run"), read, "reserved for measuring")
    assert not (tmp_path / "run").exists()


def test_a_recording_names_its_cast_and_only_measures(annotate_cloud, tmp_path):
    session = tmp_path / "judge.mcap"
    command = ("simulate", session, "--frames", 1, "--difficulty", "clean", "--cast", "judge")
    assert annotate_cloud(*command).code == 0
    truth, labels = tmp_path / "judge.truth", tmp_path / "labels"
    assert Session(session).cast == LabelSet.open(truth).info["cast"] == "judge"
    suit = tmp_path / "judge.suit.toml"
    assert annotate_cloud("label", session, "--suit", suit, "--out", labels).code == 0
    assert LabelSet.open(labels).info["cast"] == "judge"
    for path in (truth, labels):
        done = annotate_cloud("train", path, "--out", tmp_path / "run")
        assert_refused(done, path, "reserved for measuring")
    done = annotate_cloud("train-labels", session, session, "--out", tmp_path / "run")
    assert_refused(done, truth, "reserved for measuring")
    plain = make(tmp_path / "plain", LabelSet.open(truth).intrinsics, list(LabelSet.open(truth)))
    given = ("--truth", plain.path, "--truth", plain.path)
    done = annotate_cloud("train-labels", session, session, *given, "--out", tmp_path / "run")
    assert_refused(done, session, "reserved for measuring")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("command", "says"),
    [
        (("simulate", "x.mcap", "--scene", "plate", "--cast", "judge"), "leave out --cast"),
        (("synth", "generate", "--motion", "m.bvh", "--cast", "judge", "--out", "x"), "--motion"),
        (
            ("synth", "generate", "--preset", "people", "--garments", "g", "--cast", "judge", "--out", "x"),
            "--garments",
        ),
    ],
)
def test_what_is_not_of_the_cast_is_refused_with_it(annotate_cloud, tmp_path, monkeypatch, command, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.bvh").write_text("HIERARCHY\n")
    (tmp_path / "g").mkdir()
    assert_refused(annotate_cloud(*command), says)
    assert not (tmp_path / "x").exists() and not (tmp_path / "x.mcap").exists()


def test_every_image_that_shares_a_held_out_body_is_left_out(tmp_path):
    pairs = [["a", "b"], ["b", "c"], ["c", "a"], ["d", "e"], ["e"]]
    frames = [replace(blocks(i), subject=pair[0], notes={BODIES: pair}) for i, pair in enumerate(pairs)]
    data = make(tmp_path / "blends", CAMERA, frames)
    for name in "abcde":
        rest, held = (load_crops([data.path], **{how: frozenset({name})}) for how in ("without", "only"))
        assert not rest.showing({name}).any() and held.showing({name}).all()
        assert len(rest) + len(held) == len(pairs)
    with pytest.raises(CloudError, match="no labelled part of z"):
        load_crops([data.path], only=frozenset({"z"}))


def test_a_subject_of_a_rig_stands_for_its_bodies(tmp_path):
    """Subjects of two recordings that share a body are held out together."""
    seeds = (5, 6)
    bodies = {(s, n): set(episode.blended_bodies(TRAINING, s, n)) for s in seeds for n in range(8)}
    sets = []
    for seed in seeds:
        frames = [replace(blocks(n), subject=f"subject-{n}", notes={}) for n in range(8)]
        data = LabelSet.create(tmp_path / str(seed), CAMERA, {"source": f"virtual-sofa-hard-{seed}"})
        for frame in frames:
            data.write(frame)
            assert bodies_in(data, frame) == bodies[seed, int(frame.frame_id)]
        sets.append(data.path)
    held = bodies[5, 0] | bodies[6, 0]
    rest = load_crops(sets, without=frozenset({"subject-0"}))
    assert len(load_crops(sets, only=frozenset({"subject-0"}))) == 2
    assert len(rest) == sum(own.isdisjoint(held) for own in bodies.values())


def test_learning_leaves_out_whole_people_where_there_are_enough():
    pairs = [("a", "b"), ("b", "c"), ("d",), ("e",), ("f", "g"), ("d",)]
    frames = [CorrectedFrame(blocks(i), blocks(i), i, frozenset(p)) for i, p in enumerate(pairs)]
    fold_of = folds(frames)
    for fold in range(FOLDS):
        held = [f for f, n in zip(frames, fold_of, strict=True) if n == fold]
        rest = [f for f, n in zip(frames, fold_of, strict=True) if n != fold]
        assert held and all(one.bodies.isdisjoint(other.bodies) for one in held for other in rest)


def test_ways_of_standing_and_attire_follow_the_cast():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        how = draw_standing(rng, JUDGE)
        assert how.cast == JUDGE and how.stance in table_of(JUDGE, "poses/standing")["stances"]
        assert set(draw_attire(rng, False, JUDGE).names).isdisjoint(draw_attire(rng, False).names)


def test_the_manifest_of_an_order_is_json():
    manifest = Order(JUDGE_PRESETS["people"], 3, 1).manifest()
    assert json.loads(json.dumps(manifest))["cast"] == "judge"

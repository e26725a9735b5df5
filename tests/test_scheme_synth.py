"""Synthetic data in any scheme: the same images, parts that are unions of regions, things by their names."""

import hashlib
import re
from dataclasses import replace

import numpy as np
import pytest

from annotate.labelset.convert import convert
from annotate.labelset.dataset import MANIFEST, Dataset, encode_shard, sha256
from annotate.labelset.scheme_note import scheme_in, scheme_note
from annotate.parts import PAPER, UNDEFINED
from annotate.scheme.colours import with_proposed_colors
from annotate.scheme.merging import conversion_table
from annotate.scheme.regions import REGION_NEIGHBOURS, Region
from annotate.scheme.scheme import Part, scheme_of
from annotate.scheme.scheme_file import SHIPPED, load_scheme
from annotate.suit.palette import DEFAULT_SUIT
from synth.images.dataset_page import render, statistics_of
from synth.images.generate import Order
from synth.images.presets import preset_named, sample
from synth.rig.truth import thing_table, truth_labels
from synth.rig.virtual_rig import RigOptions, VirtualRig
from synth.surface.furniture import THING_NAMES, Surface
from synth.surface.wheelchair import draw_wheelchair
from tests.helpers.schemes import WARD
from tests.helpers.shards import write_dataset

ATLAS = load_scheme("atlas")
SHARDS = {
    ("sitting-train", 0, 3): "1b1bd42bba37511d8a81655574cd41602e9d203db62a8ec4ce7602765f12cadb",
    ("recumbent", 40, 2): "62102e096bec196d3b42d45868d8b775017afe3ddf7d07bdaeb4cc7ae30960c5",
    ("people", 24, 4): "d30a83a032c87ee052c592af4bb89be47ae5de8f55a02eb9c40042a7a892421d",
    ("standing", 0, 2): "908e25a47e99fddc40b29cd2ebcb24e76de44acbeee2c95bda9b697a3146eac1",
}
"""SHA-256 of shards of seed 3, by preset, first index and number of images: of the paper's presets as commit
59bdbe38 wrote them, of ``people`` and ``standing`` with the cameras of commit 2038ff9f."""
SCHEMES = [*map(load_scheme, SHIPPED[1:]), WARD]


def _furnished():
    names = sorted(set(THING_NAMES.values()))
    parts = [
        *load_scheme("six").parts,
        *(Part(i, name, name, (0, 0, 0)) for i, name in enumerate(names, 100)),
    ]
    return with_proposed_colors(scheme_of("furnished", parts), range(100, 200))


FURNISHED = _furnished()
"""Six parts and every thing of the simulator."""


def images(name, scheme=PAPER, first=0, count=2):
    preset = replace(preset_named(name), scheme=scheme)
    return [sample(preset, 3, i) for i in range(first, first + count)]


@pytest.mark.parametrize(("order", "digest"), SHARDS.items())
def test_shards_of_the_paper_keep_their_bytes(order, digest):
    name, first, count = order
    assert hashlib.sha256(encode_shard(images(name, PAPER, first, count))).hexdigest() == digest


def test_the_atlas_has_the_regions_ids_names_and_neighbours():
    assert {part.id: part.regions for part in ATLAS.parts} == {region: {region} for region in Region}
    assert [part.name for part in ATLAS.parts] == [region.label for region in Region]
    assert ATLAS.neighbours == REGION_NEIGHBOURS


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_images_are_the_same_in_every_scheme_and_every_scheme_follows_from_the_atlas(scheme):
    pairs = zip(images("people", ATLAS), images("people", scheme), strict=True)
    for fine, frame in pairs:
        assert frame.scheme == scheme
        np.testing.assert_array_equal(frame.depth_mm, fine.depth_mm)
        np.testing.assert_array_equal(frame.parts, conversion_table(ATLAS, scheme)[fine.parts])
        shares, fine_shares = frame.notes.pop("visible"), fine.notes.pop("visible")
        assert frame.notes == fine.notes and len(shares) == scheme.n_classes and shares[0] == fine_shares[0]
        for part in scheme.parts:
            own = [fine_shares[region] for region in part.regions]
            assert not own or min(own) - 0.001 <= shares[part.id] <= max(own) + 0.001


def test_a_dataset_and_its_page_name_the_scheme(tmp_path):
    frames = images("people", ATLAS)
    (tmp_path / "s.tar").write_bytes(encode_shard(frames))
    order = Order(replace(preset_named("people"), scheme=ATLAS), 2, 3)
    assert scheme_in(order.manifest(), tmp_path) == ATLAS
    assert "scheme" not in Order(preset_named("people"), 2, 3).manifest()
    shards = (("s.tar", sha256(tmp_path / "s.tar")),)
    dataset = Dataset(tmp_path, shards, order.manifest() | {"images": 2}, ATLAS)
    page = render(dataset)
    assert "24 body parts of scheme atlas" in page and "Left fingers" in page
    pixels = statistics_of(frames, ATLAS).pixels
    assert pixels.shape == (25,) and pixels.sum() == 2 * 212 * 212
    assert not (tmp_path / MANIFEST).exists() and scheme_note(ATLAS)["scheme"]["name"] == "atlas"


def test_shares_of_joined_parts_are_left_out_by_convert_and_by_the_page(tmp_path):
    frames = images("people", ATLAS)
    dataset = write_dataset(tmp_path / "atlas", frames)
    made = convert(dataset, load_scheme("six"), tmp_path / "six", lambda _: None, overwrite=False)
    assert [one.notes["visible"] for one in made] == [one.notes["visible"][:1] for one in frames]
    info = Order(preset_named("people"), 2, 3).manifest()
    cells = [
        re.findall(r'<td class="num">([^<]*)</td></tr>', render(replace(one, info=info)))
        for one in (dataset, made)
    ]
    assert cells[1] == ["-"] * 6 and len(cells[0]) == 24 and all(cell.endswith(" %") for cell in cells[0])


def truth_of(scene, scheme, difficulty="clean", cast="training"):
    options = RigOptions(scene, draft=True, suit=DEFAULT_SUIT, scheme=scheme, cast=cast)
    rig = VirtualRig(1, 1, difficulty, 5, options)
    ((frame, known),) = rig.with_truth()
    return frame, truth_labels(frame, known, rig.calibration.depth, rig.scheme)


@pytest.mark.parametrize(
    ("scene", "cast"), [("wheelchair", "training"), ("wheelchair", "judge"), ("bed", "training")]
)
def test_recordings_are_the_same_in_every_scheme_and_things_become_background(scene, cast):
    (frame, truth), (again, coarse) = (truth_of(scene, scheme, cast=cast) for scheme in (WARD, PAPER))
    assert frame.color_encoded == again.color_encoded
    np.testing.assert_array_equal(frame.depth_mm, again.depth_mm)
    np.testing.assert_array_equal(frame.thermal_c, again.thermal_c)
    np.testing.assert_array_equal(coarse.parts, conversion_table(WARD, PAPER)[truth.parts])
    np.testing.assert_array_equal(coarse.persons, truth.persons)
    assert truth.scheme == WARD and truth.notes == coarse.notes
    wheelchair = WARD.part_id["wheelchair"]
    assert ((truth.parts == wheelchair).sum() > 500) == (scene == "wheelchair")
    assert not truth.persons[WARD.is_thing[truth.parts]].any()


def test_every_surface_is_the_thing_of_its_name():
    table, names = thing_table(FURNISHED), {part.id: part.name for part in FURNISHED.parts}
    for surface in Surface:
        assert names.get(int(table[surface])) == THING_NAMES.get(surface)
    assert not thing_table(PAPER).any() and table[UNDEFINED] == 0
    _, truth = truth_of("bed", FURNISHED)
    shown = {names[i] for i in np.unique(truth.parts) if 100 <= i < UNDEFINED}
    assert {"bed", "wall", "floor"} <= shown and "wheelchair" not in shown
    assert (truth.parts[truth.depth_mm > 0] > 0).all()


def test_a_wheelchair_stands_on_the_floor_and_is_alike_on_both_sides():
    for cast in ("training", "judge"):
        chair = draw_wheelchair(cast, np.random.default_rng(2))
        mesh = chair.mesh()
        low, high = mesh.vertices_m.min(axis=0), mesh.vertices_m.max(axis=0)
        assert set(mesh.tags.tolist()) == {Surface.WHEELCHAIR}
        assert low[2] == pytest.approx(0, abs=0.002) and chair.height < high[2] < 1.1
        assert low[0] == pytest.approx(-high[0], abs=1e-3) and 0.5 < high[0] - low[0] < 0.8
        assert chair.footprint.half_width_m >= high[0] - 0.01

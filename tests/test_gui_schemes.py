"""The window in every scheme: palette, colours, sides, clean-up, and things beside the body."""

import numpy as np
import pytest
from PySide6.QtCore import QPoint, QRect, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QLabel

from annotate.correction.audit import audit
from annotate.correction.correction import Correction
from annotate.correction.relabel import relabel
from annotate.gui.state.outcome import Outcome
from annotate.labelset.journal import Journal
from annotate.labelset.label_set import LabelSet, validate
from annotate.scheme.limbs import limbs_of
from annotate.scheme.scheme import BACKGROUND, Part, Scheme, scheme_of
from annotate.scheme.scheme_file import load_scheme
from bench.window import figure
from sensors.errors import CloudError, FormatError
from tests.helpers.figure_sets import figure_set, regions_of
from tests.helpers.gui_driver import Driver
from tests.helpers.schemes import WARD

SMPL, SIX, FEET = map(load_scheme, ("smpl-24", "six", "hands-and-feet"))
CHAIR = WARD.part_id["wheelchair"]


def crowded(things: int) -> Scheme:
    """SMPL's parts and things without colours or keys."""
    parts = [Part(40 + i, f"thing_{i}", f"Thing {i}", (2 * i, 200, 100)) for i in range(things)]
    return scheme_of("crowded", [*SMPL.parts, *parts])


@pytest.fixture
def opened(qapp, tmp_path):
    """Open a window on a new set in a scheme, or on the same set again; an earlier window is closed."""
    drivers = []

    def close() -> None:
        while drivers:
            drivers.pop().close()

    def open_(scheme: Scheme, **options) -> Driver:
        close()
        path = tmp_path / scheme.name
        if not path.exists():
            figure_set(path, [0.9, 0.5], scheme=scheme)
        drivers.append(Driver(path, **options))
        return drivers[-1]

    yield open_
    close()


def part_at(driver: Driver, part: int) -> QPoint:
    return driver.place(driver.middle_of(part))


@pytest.mark.parametrize("scheme", [SMPL, SIX, WARD], ids=lambda scheme: scheme.name)
def test_the_palette_has_every_part_and_a_click_or_key_chooses_it(opened, scheme):
    driver = opened(scheme)
    palette = driver.panels.palette_
    assert {*palette.tiles} == {*scheme.by_id, 255}
    for part in scheme.parts:
        tile = palette.tiles[part.id]
        assert tile.accessibleName() == part.title
        QTest.mouseClick(tile, Qt.MouseButton.LeftButton, pos=QPoint(12, tile.height() // 2))
        assert driver.edits.part == part.id
        driver.window.choose(scheme.parts[0].id)
        if part.key:
            driver.press(part.key)
            assert driver.edits.part == part.id, part.name
        driver.key(f"lock_{part.name}") if part.key else None
        assert (part.id in driver.edits.locks) == bool(part.key)
    captions = [label.text() for label in palette.findChildren(QLabel)]
    assert ("THINGS" in captions) == (scheme == WARD)
    assert ("THEIR RIGHT" in captions) == (scheme != SIX)


def test_what_is_drawn_has_the_scheme_s_colours(opened):
    driver = opened(SMPL)
    shown = np.unique(driver.picture().reshape(-1, 3), axis=0).astype(float)
    shown, colors = shown[shown.max(axis=1) > 40], SMPL.palette_rgb()
    for part in ("left_hand", "spine2", "right_foot"):
        wanted = colors[SMPL.part_id[part]].astype(float)
        # Shade scales a colour.
        shades = shown / shown.max(axis=1, keepdims=True)
        assert (np.abs(shades - wanted / wanted.max()).max(axis=1) < 0.03).any(), part


def test_sides_are_exchanged_limb_by_limb(opened):
    driver = opened(SMPL)
    before = driver.parts.copy()
    driver.hover(part_at(driver, SMPL.part_id["left_foot"]))
    driver.key("swap")
    legs = next(limb for limb in limbs_of(SMPL) if SMPL.part_id["left_foot"] in limb.ids)
    expected = np.where(np.isin(before, [*legs.ids]), SMPL.swap_left_right(before), before)
    np.testing.assert_array_equal(driver.parts, expected)
    assert "Left and right legs swapped" in driver.said
    (stroke,) = driver.correction.journal.strokes(driver.window.frame_id)
    assert stroke.operation == "swap_left_right" and (before != expected).any()


def test_sides_of_a_scheme_without_sides_are_refused(opened):
    driver = opened(SIX)
    driver.hover(part_at(driver, SIX.part_id["upper_arms"]))
    driver.key("swap")
    assert "two sides" in driver.said and not driver.correction.journal.strokes(driver.window.frame_id)


def test_islands_and_doubts_are_of_the_scheme(opened):
    driver = opened(FEET)
    hand, foot = FEET.part_id["left_hand"], FEET.part_id["left_foot"]
    driver.window.choose(hand)
    driver.edits.editor().paint(np.flatnonzero(driver.parts.ravel() == foot)[:40], hand)
    driver.key("doubt")
    assert "left hand: 40 pixels, an island" in driver.said
    driver.key("remove_islands")
    driver.key("remove_islands")
    assert "Islands removed: 40 pixels (40 left hand)" in driver.said


def test_a_wheelchair_is_drawn_undone_saved_and_opened_the_same(opened, tmp_path):
    driver = opened(WARD)
    view = driver.views.depth
    driver.window.choose(CHAIR)
    driver.key("rectangle")
    before = driver.parts.copy()
    v, u = np.unravel_index(driver.middle_of(WARD.part_id["hip"]), before.shape)
    pixels = [int(row * before.shape[1] + column) for row, column in ((v, u), (v + 60, u + 60))]
    corners = [driver.place(pixel, view) for pixel in pixels]
    driver.drag(corners, view=view)
    assert (driver.parts == CHAIR).any(), "of the body"
    driver.key("undo")
    np.testing.assert_array_equal(driver.parts, before)
    driver.key("room")
    driver.drag(corners, view=view)
    drawn = driver.parts.copy()
    assert ((drawn == CHAIR) & (before == BACKGROUND)).sum() > 500
    driver.key("undo")
    np.testing.assert_array_equal(driver.parts, before)
    driver.key("redo")
    np.testing.assert_array_equal(driver.parts, drawn)
    tile = driver.panels.palette_.tiles[CHAIR]
    assert tile.count == (drawn == CHAIR).sum() and "wheelchair" in driver.panels.status.next.text()
    driver.key("save")
    labels = LabelSet.open(tmp_path / "ward")
    assert validate(labels) == []
    np.testing.assert_array_equal(labels.read("000000").parts, drawn)
    assert not labels.read("000000").on_person[drawn == CHAIR].any()
    again = opened(WARD)
    np.testing.assert_array_equal(again.parts, drawn)
    (person,) = audit(labels, Journal.of(labels.path, WARD)).people
    assert person.parts["wheelchair"].gained_px == (drawn == CHAIR).sum()


def test_a_click_on_the_wheelchair_takes_a_piece_of_it(opened):
    driver = opened(WARD)
    room = np.zeros(driver.parts.shape, np.bool_)
    room[150:190, 150:200] = True
    driver.edits.editor().paint(room, CHAIR)
    driver.key("save")
    driver.window.frames.forget()
    driver.window.show_anew(driver.window.frames.read(driver.window.frame_id), Outcome(""))
    driver.settle()
    driver.key("head")
    driver.click(driver.place(driver.middle_of(CHAIR), driver.views.depth), view=driver.views.depth)
    assert "from wheelchair to head" in driver.said


@pytest.mark.parametrize("size", [(1280, 800), (1280, 680)])
def test_forty_parts_are_all_in_sight_and_more_scroll(opened, size):
    driver = opened(crowded(16))
    driver.window.resize(*size)
    driver.settle()
    palette = driver.panels.palette_
    assert len(SMPL.parts) + 16 == 40 and (driver.window.width(), driver.window.height()) == size
    assert palette.verticalScrollBar().maximum() == 0
    for tile in palette.tiles.values():
        inside = QRect(tile.mapTo(palette, QPoint(0, 0)), tile.size())
        assert palette.rect().contains(inside) and tile.height() >= 16
        assert tile.rect().contains(tile.lock_rect) and tile.rect().contains(tile.eye_rect)
        assert not tile.lock_rect.intersects(tile.eye_rect)
    assert min(view.height() for view in driver.views) >= 100


def test_a_hundred_parts_scroll_and_the_smallest_window_too(opened):
    driver = opened(crowded(90))
    driver.window.resize(1, 1)
    driver.settle()
    palette = driver.panels.palette_
    assert palette.verticalScrollBar().maximum() > 0
    last = palette.tiles[40 + 89]
    palette.ensureWidgetVisible(last)
    driver.settle()
    place = last.mapTo(palette.viewport(), last.rect().center())
    assert palette.viewport().rect().contains(place)
    QTest.mouseClick(last, Qt.MouseButton.LeftButton, pos=QPoint(12, 8))
    assert driver.edits.part == 40 + 89


def test_another_set_is_compared_in_this_scheme_or_refused(opened, tmp_path):
    fine = figure_set(tmp_path / "fine", [0.9, 0.5], scheme=SMPL)
    driver = opened(FEET, other=fine)
    other = driver.edits.frame.scene.other
    np.testing.assert_array_equal(other, FEET.table[regions_of_figure(driver)])
    with pytest.raises(FormatError, match=r"lies in several parts of scheme 'smpl-24'"):
        opened(SMPL, other=LabelSet.open(tmp_path / "hands-and-feet"))


def regions_of_figure(driver: Driver) -> np.ndarray:
    _, parts = figure(*driver.parts.shape, 0.0)
    return regions_of(parts)


def test_the_menus_keep_their_letters_where_no_part_has_them(opened):
    titles = [action.text() for action in opened(SMPL).panels.header.menus.actions()]
    assert titles == ["&File", "Edit", "Parts", "&Tools", "F&rames", "&View", "&Help"]


def test_a_set_in_one_scheme_is_not_relabelled_in_another(tmp_path):
    labels = figure_set(tmp_path / "labels", [0.9], scheme=FEET)
    learnt = figure_set(tmp_path / "learnt", [0.9], scheme=SIX)
    with (
        Correction.open(labels.path, "mia") as correction,
        pytest.raises(CloudError, match=r"'six', .* has 'hands-and-feet'; run learn again"),
    ):
        relabel(correction, learnt)

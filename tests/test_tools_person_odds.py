"""Odds of detections are fitted to persons, not to their pieces."""

import numpy as np

from annotate.person.detection.finder import Person
from annotate.person.detection.odds import Evidence
from eval.training.rooms.scenes import Scene
from tests.helpers.furnished_room import CAMERA, seen
from tools.finder import person_odds


def test_a_piece_beside_a_larger_detection_of_the_person_is_false(monkeypatch):
    depth_m, persons = seen([(1, 0.0)])
    depth_mm = (1000 * np.nan_to_num(depth_m)).astype(np.uint16)
    scene = Scene(CAMERA, depth_mm, np.full(depth_mm.shape, np.nan, np.float32), persons, "rig")
    row = int(np.quantile(np.nonzero(persons)[0], 0.8))

    def pieces(cloud, warmth, least_odds):
        """Return detections of the upper part, of the lower part and of the room."""
        shown = np.where(cloud.valid, persons[: len(cloud.valid), : cloud.valid.shape[1]], 0) > 0
        upper = np.arange(len(shown))[:, None] < row
        masks = (shown & upper, shown & ~upper, cloud.valid & ~shown)
        return [Person(mask, 0.1, np.zeros(3), Evidence(1.0, 0.1)) for mask in masks]

    monkeypatch.setattr(person_odds, "find_people", pieces)
    assert [truth for _, truth in person_odds.examples(scene)] == [True, False, False]

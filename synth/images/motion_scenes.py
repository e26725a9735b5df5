"""Stages out of recorded motions: their poses on the floor, or on a seat where somebody sits."""

from dataclasses import dataclass

import numpy as np

from synth.body.body import Body
from synth.images.posed_scenes import Stage
from synth.images.viewpoints import Around
from synth.motion.placed import stand, take_seat
from synth.motion.repertoire import Repertoire
from synth.surface.furniture import Chair, Ground, Sofa


@dataclass(frozen=True, eq=False)
class Moved:
    """A staging that draws a frame of any motion, seen as the standing are."""

    repertoire: Repertoire

    def __call__(self, rng: np.random.Generator, body: Body) -> Stage:
        """A body as somebody was in a recording."""
        name, motion, frame = self.repertoire.draw(rng)
        if not motion.sits[frame]:
            return Stage((name,), *stand(body, motion, frame), Ground().mesh(), Around(), bags=True)
        kind = Sofa if rng.random() < 0.5 else Chair
        posed, seat = take_seat(body, motion, frame, kind.sample(rng))
        return Stage((name,), *posed, seat.mesh(), Around())

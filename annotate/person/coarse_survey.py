"""The persons of a frame by its coarse cloud, with their outlines in the whole image."""

from dataclasses import replace

from annotate.array_types import UInt8
from annotate.cloud.coarse import CoarseCloud
from annotate.frame_labels import FrameLabels
from annotate.person.extract import PersonMask, Survey
from annotate.person.planes import Plane


class CoarseSurvey:
    """As `Survey`, of a coarse cloud: in less time."""

    def __init__(
        self, cloud: CoarseCloud, window_c: tuple[float, float] | None = None, *, everybody: bool = False
    ) -> None:
        self.cloud = cloud
        self._survey = Survey(cloud.cloud, window_c, everybody=everybody)
        self._enlarged: dict[bytes, UInt8] = {}

    def person(self, before: FrameLabels | None = None) -> PersonMask:
        """The person, see ``Survey.person``; before: labels of the previous frame, of the whole image."""
        found = self._survey.person(None if before is None else self.cloud.coarse(before))
        # With the frame before the persons are mostly the same as without.
        key = found.persons.tobytes()
        if key not in self._enlarged:
            self._enlarged[key] = self.cloud.enlarged(found.persons)
        persons = self._enlarged[key]
        return replace(found, mask=persons == 1, persons=persons)

    @property
    def planes(self) -> tuple[Plane, ...]:
        """Planes of the room."""
        return self._survey.planes

"""The persons of a frame by its coarse cloud, with their outlines in the whole image."""

from dataclasses import replace

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

    def person(self, before: FrameLabels | None = None) -> PersonMask:
        """The person, see ``Survey.person``; before: labels of the previous frame, of the whole image."""
        found = self._survey.person(None if before is None else self.cloud.coarse(before))
        persons = self.cloud.enlarged(found.persons)
        return replace(found, mask=persons == 1, persons=persons)

    @property
    def planes(self) -> tuple[Plane, ...]:
        """Planes of the room."""
        return self._survey.planes

"""Everything that a report shows, gathered before a line of it is drawn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

from annotate.correction.audit import Audit
from eval.compare.paired import Difference, difference
from eval.compare.results import Result
from eval.report.gallery import GalleryFrame
from eval.report.history import Training
from eval.report.scenes import Scene
from eval.report.views import ResultView, view_of
from sensors.errors import CloudError


@dataclass(frozen=True)
class ShownSet:
    """Labels of frames without a truth: to be shown, not scored. note: a remark on them."""

    title: str
    frames: Sequence[GalleryFrame]
    scenes: Sequence[Scene] = ()
    note: str = ""


@dataclass(frozen=True)
class Material:
    """Results in the order they are shown, the first being what the others are compared with.

    ceiling: two corrections of the same frames against each other, what no labelling can beat.
    galleries: frames by the title of the result they belong to. scenes: frames to turn in 3D. trainings:
    of the networks compared. audits: people's work, by the title of the label set. shown: label sets
    without truth. facts: what was done with what (command, seed, hashes), shown as given.
    Raises CloudError without results, or when two have one title.
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
            raise CloudError("there are no results; give at least one that evaluate wrote")
        titles = [result.title for result in self.results]
        twice = next((title for title in titles if titles.count(title) > 1), None)
        if twice is not None:
            raise CloudError(f"two results have the title {twice!r}; evaluate one again with another --title")

    @cached_property
    def views(self) -> list[ResultView]:
        """Numbers of each result."""
        return [view_of(result) for result in self.results]

    @cached_property
    def differences(self) -> list[Difference]:
        """Every result but the first, less the first."""
        return [difference(result, self.results[0]) for result in self.results[1:]]

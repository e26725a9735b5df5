"""Declarations of a user about a recording: facts that it does not state, or states wrongly."""

from dataclasses import dataclass
from pathlib import Path

from sensors.errors import CloudError

TURNS_DEG = (0, 90, 180, 270)


@dataclass(frozen=True)
class ImportOptions:
    """Declared facts, each of which replaces a stated or assumed one; None or "" = not declared.

    intrinsics: a file of the depth camera's numbers (``intrinsics_file``). depth_unit_mm: millimetres of a
    depth step. turn_deg: clockwise turn that makes the images upright: 0, 90, 180 or 270. mirror: whether
    they are mirrored left to right, which is undone before they are turned. subject: name of the person.
    rate_hz: frames a second of sources without time stamps. topics: of a bag: depth's, then colour's. axes:
    of a cloud, a name of ``clouds.axes.AXES``. Raises CloudError for impossible values.
    """

    intrinsics: Path | None = None
    depth_unit_mm: float | None = None
    turn_deg: int = 0
    mirror: bool = False
    subject: str = ""
    rate_hz: float | None = None
    topics: tuple[str, ...] = ()
    axes: str = ""

    def __post_init__(self) -> None:
        if self.depth_unit_mm is not None and not 0 < self.depth_unit_mm <= 1000:
            raise CloudError(f"depth unit is {self.depth_unit_mm:g} mm; give more than 0, up to 1000")
        if self.turn_deg not in TURNS_DEG:
            raise CloudError(f"turn is {self.turn_deg} degrees; give {', '.join(map(str, TURNS_DEG))}")
        if self.rate_hz is not None and not 1e-3 <= self.rate_hz <= 1e4:
            raise CloudError(f"rate is {self.rate_hz:g} Hz; give 0.001 to 10000")
        if len(self.topics) > 2:
            raise CloudError(f"{len(self.topics)} topics are given; give the topic of depth, then of colour")

    @property
    def period_ns(self) -> int:
        """Return the nanoseconds from frame to frame of a source without time stamps."""
        # Imported here: help imports no arrays.
        from sensors.rig.frame import FRAME_PERIOD_NS

        return round(1e9 / self.rate_hz) if self.rate_hz else FRAME_PERIOD_NS

    @property
    def rate(self) -> str:
        """Return the rate of a source without time stamps, as text."""
        rate_hz, origin = (self.rate_hz, "as declared") if self.rate_hz else (30, "assumed")
        return f"{rate_hz:g} frames a second {origin}"


AS_STATED = ImportOptions()  # declares nothing

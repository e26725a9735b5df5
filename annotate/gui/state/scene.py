"""Scene of one frame: its points and the data for all colourings. No GUI here."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from annotate.array_types import Bool, Float32, Int32, Int64, UInt8
from annotate.cloud.thermal_cloud import ThermalCloud
from annotate.correction.correction import Correction
from annotate.correction.relabel import before_step
from annotate.correction.select import edit_supervoxels
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.labelset.source_recording import Recorded
from annotate.scheme.merging import conversion_table
from annotate.witness.shown_person import ShownPerson, shown_people
from sensors.errors import CloudError, FormatError

NEAR_PX = 10  # width of the room around the person that is shown in full: a limb may be missing; untuned
ROOM_POINTS = 50_000  # to which the rest of the room is thinned, about; untuned


@dataclass(frozen=True)
class FrameScene:
    """One frame, read and fused; arrays are (h, w, ...) or flat over its pixels.

    labels: as stored at the time of reading. cloud: points, with colours and temperatures of a session.
    other: part ids (h, w) of the compared set, or from before the last fine-tuning, or None. near: bool (h *
    w,), points that are all drawn. room: int64 (k,), other pixels that are drawn, every ``room_step``th along
    each side. shade: float32 (h * w,), 0 edge-on to 1 head-on. pieces: int32 (h, w), supervoxels for clicks,
    -1 = none. remark: missing data and the reason, or "". no_other: the reason why no set is compared.
    witnessed: people as a colour network shows them, by the notes of this set, or else of the compared one.
    """

    labels: FrameLabels
    cloud: ThermalCloud
    other: UInt8 | None
    near: Bool
    room: Int64
    room_step: int
    shade: Float32
    pieces: Int32
    remark: str = ""
    no_other: str = "nothing to compare: give another label set with --compare"
    witnessed: tuple[ShownPerson, ...] = ()

    @property
    def points_m(self) -> Float32:
        """Return points (h * w, 3) in metres, depth-camera frame, NaN without a reading."""
        return self.cloud.points_m.reshape(-1, 3)

    @cached_property
    def depth_range_m(self) -> tuple[float, float]:
        """Return the least and greatest depth of the colour scale: of the person with a margin, else of the
        room.
        """
        depth_mm = self.labels.depth_mm
        person = depth_mm[(self.labels.parts > 0) & (depth_mm > 0)]
        known = person if len(person) else depth_mm[depth_mm > 0]
        near, far = np.percentile(known, [1, 99]) / 1000 if len(known) else (1.0, 2.0)
        return float(near) - 0.1, float(far) + 0.2


class SceneReader:
    """Reader of a set's scenes, for any thread. has_recording: True if scenes have a recording's colours."""

    def __init__(
        self, correction: Correction, session: Path | None = None, other: LabelSet | None = None
    ) -> None:
        """Open the recording, and check its frame size.

        session: recording for colours and temperatures. other: label set to compare. Raises FormatError where
        the session or the other set has frames of another size, or the other set's scheme does not convert.
        """
        self._correction, self.other = correction, other
        labels = self.labels = correction.labels
        self._recorded = Recorded(labels, session)
        self.has_recording = session is not None
        if other and other.intrinsics.shape != labels.intrinsics.shape:
            raise FormatError(
                f"{other.path} has frames of {other.intrinsics.shape}, {labels.path} of "
                f"{labels.intrinsics.shape}; compare two sets of the same recording"
            )
        self._in_scheme = conversion_table(other.scheme if other else labels.scheme, labels.scheme)

    def read(self, frame_id: str) -> FrameScene:
        """Read one frame. Raises FormatError with the file that is missing or corrupt.

        Colours, temperatures and parts of the other set that cannot be read are left out with a remark.
        """
        labels = self._correction.frame(frame_id)
        other, unlike, notes = self._compared(labels)
        cloud, _, without = self._recorded.fused(labels)
        near, room, step = levels(labels, other)
        color = cloud.color_rgb if cloud.color_valid.any() else None
        pieces = edit_supervoxels(labels, cloud.camera, color)
        remark = "; ".join(filter(None, [without, unlike]))
        scene = FrameScene(labels, cloud, other, near, room, step, shade_of(cloud), pieces, remark)
        witnessed = tuple(shown_people(labels.notes) or shown_people(notes))
        return replace(scene, witnessed=witnessed, no_other=unlike or scene.no_other)

    def _compared(self, labels: FrameLabels) -> tuple[UInt8 | None, str, dict[str, Any]]:
        """Return the other parts (h, w), the reason why there are none, and the other set's notes."""
        if self.other is None:
            return before_step(self._correction, labels.frame_id), "", {}
        try:
            other = self.other.read(labels.frame_id)
        except CloudError as error:
            return None, f"nothing to compare: {error}", {}
        if not np.array_equal(other.depth_mm, labels.depth_mm):
            return None, f"nothing to compare: {self.other.path} shows another depth image", {}
        return self._in_scheme[other.parts], "", other.notes


def levels(
    labels: FrameLabels, other: UInt8 | None, room_points: int = ROOM_POINTS
) -> tuple[Bool, Int64, int]:
    """Return the pixels to draw: flags (h * w,) near the person, thinned others (k,), and their step.

    room_points: approximate number of the thinned pixels.
    """
    valid = labels.depth_mm > 0
    person = labels.parts > 0
    if other is not None:
        person |= other > 0
    kernel = np.ones((2 * NEAR_PX + 1, 2 * NEAR_PX + 1), np.uint8)
    near = (cv2.dilate(person.astype(np.uint8), kernel) > 0) & valid
    rest = valid & ~near
    # A regular lattice, because a random choice leaves noise.
    step = max(1, int(np.ceil(np.sqrt(rest.sum() / room_points))))
    lattice = np.zeros_like(rest)
    lattice[::step, ::step] = True
    return near.ravel(), np.flatnonzero(rest & lattice), step


def shade_of(cloud: ThermalCloud) -> Float32:
    """Return the shade (h * w,) of unlit points: cosine between surface normal and line of sight."""
    smooth = cv2.medianBlur(cloud.depth_mm, 5).astype(np.float32) / np.float32(1000)
    # d(point)/du = z' * ray + z * d(ray)/du: the slope per metre of surface is z' * f / z.
    along_u, along_v = (cv2.Sobel(smooth, cv2.CV_32F, *d, ksize=3) / 8 for d in ((1, 0), (0, 1)))
    with np.errstate(divide="ignore", invalid="ignore"):
        slope2 = ((along_u * cloud.camera.fx) ** 2 + (along_v * cloud.camera.fy) ** 2) / smooth**2
    shade = 1 / np.sqrt(1 + slope2)
    return np.asarray(np.nan_to_num(shade, nan=1.0), np.float32).ravel()

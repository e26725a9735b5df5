"""Solved motion: joint angles over time for any body, and the fit of each marker."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from annotate.array_types import Float32, Float64, Int64, UInt8
from sensors.errors import FormatError, fault_of
from sensors.files.atomic import check_free, replacing
from sensors.files.npz import load_arrays
from synth.body.body import Body
from synth.body.skeleton import N_JOINTS, Posture
from synth.markers.person_fit import bones_of_leg, leg_length_m, zero_bones

SEEN, BRIDGED, MISSING, GHOST, SWAPPED = range(5)  # status of a marker in a frame
VERSION = 1
REMEDY = "write it with 'solve'"
MAX_BYTES = 500_000_000  # of an unpacked motion: three hours of 40 markers at 60 frames/s
# types of the arrays over frames
_TYPES = {"angles_rad": "f8", "pelvis_m": "f8", "error_m": "f4", "status": "u1"}


@dataclass(frozen=True)
class MarkerReport:
    """Fit of each marker.

    error_m: float32 (F, M), distance of the recorded marker from its place on the fitted body, metres; NaN
    where not seen or discarded. status: uint8 (F, M). unknown: labels outside the marker set. assumed:
    sentences on defects of the files.
    """

    names: tuple[str, ...]
    error_m: Float32
    status: UInt8
    unknown: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()

    @property
    def median_mm(self) -> float:
        """Return the median of ``error_m`` over all seen markers, millimetres; 0 without any."""
        found = self.error_m[np.isfinite(self.error_m)]
        return float(np.median(found)) * 1000 if found.size else 0.0

    @property
    def rms_mm(self) -> float:
        """Return the root mean square of ``error_m`` over all seen markers, millimetres; 0 without any."""
        found = self.error_m[np.isfinite(self.error_m)].astype(np.float64)
        return float(np.sqrt(np.mean(found**2))) * 1000 if found.size else 0.0

    def count(self, status: int) -> Int64:
        """Return for each marker (M,) the number of frames with a status."""
        return np.asarray((self.status == status).sum(axis=0), np.int64)

    def longest_gap(self) -> Int64:
        """Return the length in frames (M,) of each marker's longest gap."""
        longest = np.zeros(len(self.names), np.int64)
        run = np.zeros(len(self.names), np.int64)
        for row in np.isin(self.status, (BRIDGED, MISSING)):
            run = np.where(row, run + 1, 0)
            longest = np.maximum(longest, run)
        return longest


@dataclass(frozen=True)
class Motion:
    """Joint angles over time.

    angles_rad: float64 (F, J, 3), see ``skeleton``. pelvis_m: float64 (F, 3) world, z up. bones_m: float64
    (J, 3) of the recorded person, from parent to joint in anatomical zero. Raises FormatError for impossible
    shapes or numbers.
    """

    angles_rad: Float64
    pelvis_m: Float64
    frames_per_second: float
    bones_m: Float64
    report: MarkerReport

    def __post_init__(self) -> None:
        frames = len(self.angles_rad)
        shapes = (self.angles_rad.shape, self.pelvis_m.shape)
        if frames == 0 or shapes != ((frames, N_JOINTS, 3), (frames, 3)):
            raise FormatError(
                f"angles_rad and pelvis_m have the shapes {shapes[0]} and {shapes[1]} instead of "
                f"(F, {N_JOINTS}, 3) and (F, 3) for F frames; solve again"
            )
        marked = (frames, len(self.report.names))
        if self.report.error_m.shape != marked or self.report.status.shape != marked:
            shapes = (self.report.error_m.shape, self.report.status.shape)
            raise FormatError(
                f"error_m and status are {shapes[0]} and {shapes[1]}, not {marked}; solve again"
            )
        if not (np.isfinite(self.angles_rad).all() and np.isfinite(self.pelvis_m).all()):
            raise FormatError("the motion holds numbers that are not finite; solve again")
        if self.bones_m.shape != (N_JOINTS, 3):
            raise FormatError(f"the person's bones are {self.bones_m.shape}; give ({N_JOINTS}, 3)")
        if not np.isfinite(self.bones_m).all():
            raise FormatError("the person's bones are not finite; solve again")
        if not (0 < self.leg_m < 3 and 0 < self.frames_per_second <= 10_000):
            raise FormatError(
                f"the motion has a leg of {self.leg_m:g} m and {self.frames_per_second:g} frames/s, not "
                "up to 3 m and up to 10000 frames/s; solve again"
            )

    def __len__(self) -> int:
        return len(self.angles_rad)

    @property
    def leg_m(self) -> float:
        """Return the length of the recorded person's leg from hip to ankle."""
        return leg_length_m(self.bones_m)

    def posture(self, frame: int, body: Body) -> Posture:
        """Return a frame's posture on a body: the same angles, the pelvis' path scaled to the body's legs.

        The height over the floor is as inaccurate as recorded; ``synth.motion`` puts feet on the floor and
        separates limbs.
        """
        scale = leg_length_m(zero_bones(body.joints_m)) / self.leg_m
        return Posture(self.angles_rad[frame], scale * self.pelvis_m[frame])


def save_motion(path: Path, motion: Motion, *, overwrite: bool = False) -> None:
    """Write a motion as npz without pickles, in full or not at all. Raises ExistsError."""
    check_free(path, overwrite)
    report = motion.report
    with replacing(path, overwrite) as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file,
            version=np.int64(VERSION),
            angles_rad=motion.angles_rad,
            pelvis_m=motion.pelvis_m,
            frames_per_second=np.float64(motion.frames_per_second),
            bones_m=motion.bones_m,
            names=np.array(report.names, np.str_),
            unknown=np.array(report.unknown, np.str_),
            assumed=np.array(report.assumed, np.str_),
            error_m=report.error_m,
            status=report.status,
        )


def load_motion(path: Path) -> Motion:
    """Read a motion. Raises FormatError for another kind of file, a damaged or a too large one."""
    arrays = load_arrays(path, MAX_BYTES, REMEDY)
    try:
        if int(arrays["version"]) != VERSION:
            raise ValueError(f"it is of version {int(arrays['version'])}")
        for name, kind in _TYPES.items():
            if arrays[name].dtype != np.dtype(kind):
                raise ValueError(f"{name} is {arrays[name].dtype}")
        texts = {k: tuple(map(str, arrays.get(k, ()))) for k in ("names", "unknown", "assumed")}
        report = MarkerReport(error_m=arrays["error_m"], status=arrays["status"], **texts)
        rate = float(arrays["frames_per_second"])
        # Files of version 0.2 and before hold of the person only the leg.
        bones = arrays["bones_m"] if "bones_m" in arrays else bones_of_leg(float(arrays["leg_m"]))
        return Motion(arrays["angles_rad"], arrays["pelvis_m"], rate, bones.astype(np.float64), report)
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from error
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise FormatError(f"motion {path} cannot be read ({fault_of(error)}); {REMEDY}") from error

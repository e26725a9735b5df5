"""The verb ``solve``: joint angles from markers; summary of a motion for ``info``."""

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from cli.console import Block, Json, Overwrite, block, finish, progress, say, table
from sensors.errors import CloudError
from sensors.files.atomic import check_free, check_suffix, check_there

if TYPE_CHECKING:
    from synth.markers.motion_file import MarkerReport, Motion
    from synth.motion_files.marker_files import Markers
    from synth.motion_files.marker_set import MarkerSet

ANGLES = ("flexion", "abduction", "rotation")  # in the order of ``synth.body.skeleton``
STATUSES = ("bridged", "missing", "ghost", "swapped")  # as in ``synth/markers/motion_file.py``


def solve(
    markers: Annotated[Path, Argument(help="Recording: C3D, TRC, BVH, or joints in .npz.")],
    out: Annotated[Path, Option(help="Motion file to write (.npz).")],
    static: Annotated[Path | None, Option(help="Static trial of the same person: C3D or TRC.")] = None,
    markerset: Annotated[
        Path | None, Option(help="Marker-set file (TOML). Default: the shipped set that fits best.")
    ] = None,
    picture: Annotated[
        Path | None, Option(help="Picture of the markers on the body at a few moments (.png).")
    ] = None,
    film: Annotated[
        Path | None, Option(help="Animation of the markers on the body (.webp, .gif, .png).")
    ] = None,
    up: Annotated[
        str | None, Option(help="Vertical axis of the recording: x, y, z, -x, -y, -z. Default: found.")
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Compute joint angles from recorded markers; the angles can move any body."""
    from synth.markers.motion_file import save_motion
    from synth.markers.solve import places_m
    from synth.markers.solve import solve as solve_markers
    from synth.motion.picture import ANIMATIONS, save_animation, save_picture
    from synth.motion_files.vertical_axis import given

    for given_out, suffixes in ((out, (".npz", "")), (picture, (".png", "")), (film, ANIMATIONS)):
        if given_out is not None:
            check_suffix(given_out, *suffixes)
            check_free(given_out, overwrite)
    check_there(markers, *filter(None, (static, markerset)))
    recorded, standing, places = _read(markers, static, markerset)
    if up is not None:
        recorded = replace(recorded, up=given(up))
    started = time.monotonic()
    with progress("solve", len(recorded.positions)) as advance:
        motion = solve_markers(recorded, standing, places, advance)
    rate = len(motion) / (time.monotonic() - started)
    out.parent.mkdir(parents=True, exist_ok=True)
    save_motion(out, motion, overwrite=overwrite)
    for path, save in ((picture, save_picture), (film, save_animation)):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            save(path, motion, places_m(recorded, standing, places))
    _finish(motion, rate, out, json)


def _finish(motion: "Motion", rate: float, out: Path, json: bool) -> None:
    """Print the distances between a motion and its markers. rate: frames a second."""
    report, of_markers = motion.report, _per_marker(motion.report)
    result = {
        "frames": len(motion),
        "frames_per_second": round(rate, 1),
        "marker_median_mm": round(report.median_mm, 2),
        "marker_rms_mm": round(report.rms_mm, 2),
        "markers": of_markers,
        "unknown": list(report.unknown),
        "assumed": list(report.assumed),
    }
    say(*report.assumed)
    if report.unknown:
        shown = ", ".join(report.unknown[:8]) + (", ..." if len(report.unknown) > 8 else "")
        say(f"{len(report.unknown)} labels belong to no marker of the set: {shown}")
    text = (
        f"{len(motion)} frames in {out}, {rate:.0f} a second; "
        f"markers off by {report.median_mm:.1f} mm (median), {report.rms_mm:.1f} mm (rms)"
    )
    finish(result, json, text, *_odd_markers(of_markers))


def _read(
    markers: Path, static: Path | None, markerset: Path | None
) -> "tuple[Markers, Markers | None, MarkerSet | None]":
    """Return a recording, its static trial, and its marker set. Files of joints define their own marker
    set.
    """
    from synth.motion_files.bvh import read_bvh
    from synth.motion_files.joint_file import read_joints
    from synth.motion_files.marker_files import read_markers
    from synth.motion_files.marker_set import load_marker_set

    skeletons = {".bvh": read_bvh, ".npz": read_joints}
    if (read := skeletons.get(markers.suffix.lower())) is not None:
        if static is not None or markerset is not None:
            raise CloudError(f"{markers} has its own skeleton; leave out --static and --markerset")
        recorded, places = read(markers)
        return recorded, None, places
    chosen = None if markerset is None else load_marker_set(markerset)
    return read_markers(markers), None if static is None else read_markers(static), chosen


def motion_info(path: Path) -> tuple[dict[str, Any], Block]:
    """Return length, person, and range of every joint of a motion, as JSON and as text."""
    import numpy as np

    from synth.body.skeleton import JOINTS
    from synth.markers.motion_file import load_motion

    motion = load_motion(path)
    result: dict[str, Any] = {
        "kind": "motion",
        "frames": len(motion),
        "frames_per_second": round(motion.frames_per_second, 2),
        "seconds": round(len(motion) / motion.frames_per_second, 2),
        "leg_m": round(motion.leg_m, 3),
        "markers": len(motion.report.names),
        "marker_median_mm": round(motion.report.median_mm, 2),
    }
    lines = [f"{key}: {value}" for key, value in result.items()]
    degrees = np.degrees(motion.angles_rad)
    ranges = np.stack([degrees.min(axis=0), degrees.max(axis=0)], axis=-1).round(1).tolist()
    result["joints_deg"] = {
        joint.name: dict(zip(ANGLES, own, strict=True)) for joint, own in zip(JOINTS, ranges, strict=True)
    }
    rows = [
        (name, *(f"{low:.0f} to {high:.0f}" for low, high in own.values()))
        for name, own in result["joints_deg"].items()
    ]
    lines.append(table(("joint", *(f"{angle}, deg" for angle in ANGLES)), rows))
    return result, block(*lines, gap="\n")


def _per_marker(report: "MarkerReport") -> dict[str, dict[str, float]]:
    """Return each marker's median distance to the body, and its frames by status."""
    import numpy as np

    from synth.markers.motion_file import BRIDGED, GHOST, MISSING, SWAPPED

    statuses = zip(STATUSES, (BRIDGED, MISSING, GHOST, SWAPPED), strict=True)
    counts = {word: report.count(status) for word, status in statuses}
    gap = report.longest_gap()
    result: dict[str, dict[str, float]] = {}
    for m, name in enumerate(report.names):
        errors = report.error_m[:, m]
        errors = errors[np.isfinite(errors)]
        result[name] = {"median_mm": round(1000 * float(np.median(errors)), 2)} if errors.size else {}
        result[name] |= {word: int(count[m]) for word, count in counts.items()} | {"longest_gap": int(gap[m])}
    return result


def _odd_markers(markers: dict[str, dict[str, float]]) -> list[str]:
    """Return a table of the bridged, missing, ghost or swapped markers, if any."""
    columns = ("median_mm", *STATUSES, "longest_gap")
    odd = [
        (name, *(marker.get(column) for column in columns))
        for name, marker in markers.items()
        if any(marker[word] for word in STATUSES)
    ]
    return ["", table(("marker", "median, mm", *STATUSES, "longest gap"), odd, "Frames")] if odd else []

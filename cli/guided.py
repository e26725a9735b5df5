"""Guided calibration: views of the hole plate are recorded one after another, until they suffice."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from annotate.live.rig_warnings import rig_warnings
from cli.console import say
from cli.remedies import remedied
from cli.rig_devices import check_infrared, open_rig
from sensors.calibrate.bundle import Adjusted
from sensors.calibrate.guide import Guidance, PlateSetup, guide, is_new, next_placement
from sensors.calibrate.guide_picture import guide_picture
from sensors.calibrate.hole_plate import HolePlate
from sensors.calibrate.plate_view import PlateView, view_plate, with_all_cameras
from sensors.errors import CalibrationError, FormatError
from sensors.files.atomic import check_free, write_bytes
from sensors.interrupt import Ending, ended_by_signals, interrupted_by_signals, interruptible
from sensors.recording.live_rig import LiveRig
from sensors.rig.frame import RigFrame
from sensors.rig.rig_calibration import RigCalibration
from sensors.session.reader import Session
from sensors.session.writer import SessionWriter

STILL_PX = 1.0  # most motion of the plate between two frames in the depth image; untuned
MOST_BLIND = 30  # frames without infrared, which a camera's first frames may lack, before an error; untuned


@dataclass(frozen=True)
class Guided:
    """Views of the hole plate, from a rig file or addresses and recorded to ``board``, or from session
    ``board``.

    picture: PNG of the wanted view.
    """

    board: Path
    rig: Path | None
    device: list[str] | None
    picture: Path
    overwrite: bool

    def calibrate(self, plate: HolePlate) -> Adjusted:
        """Return the calibration of the taken views. Raises CalibrationError for too few views."""
        self.picture.parent.mkdir(parents=True, exist_ok=True)
        now = self._from_rig(plate) if self.rig or self.device else self._from_session(plate)
        if now.found is None:
            raise CalibrationError(
                f"{len(now.seen)} views of the plate were taken, which are too few; hold the plate as "
                f"{self.picture} shows, still and in front of a warm area, until all cameras see every hole"
            )
        return now.found

    def _from_session(self, plate: HolePlate) -> Guidance:
        session = Session(self.board)
        check_infrared(session)
        return guided(iter(session), plate, session.calibration, self.picture, None)

    def _from_rig(self, plate: HolePlate) -> Guidance:
        check_free(self.board, self.overwrite)
        with (
            interrupted_by_signals(),
            closing(open_rig(self.rig, self.device, plate)) as running,
            ended_by_signals() as ending,
            ExitStack() as stack,
        ):
            writer = SessionWriter(self.board, running.calibration, running.name, overwrite=self.overwrite)
            begun = False

            def keep(frame: RigFrame) -> None:
                nonlocal begun
                if not begun:  # without a view, no file
                    stack.enter_context(writer)
                    begun = True
                writer.write(frame)

            return guided(rig_frames(running, ending), plate, running.calibration, self.picture, keep)


def guided(
    frames: Iterator[RigFrame],
    plate: HolePlate,
    guess: RigCalibration,
    picture: Path,
    keep: Callable[[RigFrame], None] | None,
) -> Guidance:
    """Check frames until their views suffice, they end, or Ctrl-C; print and draw the next wanted view.

    picture: a PNG, rewritten for every frame. keep: called with each frame whose view is accepted, once the
    plate is still; None = every frame is an accepted view.
    """
    setup, views = PlateSetup.of(guess, plate), list[PlateView]()
    now, before = Guidance((), next_placement(()), None, False), None
    say(f"hold the plate {now.wanted.text if now.wanted else ''}; {picture} shows where")
    try:
        with interruptible():
            for frame in frames:
                try:
                    view, known = view_plate(frame, plate, guess.depth), with_all_cameras(guess, frame)
                except FormatError as error:
                    say(remedied(error))
                    continue
                if known is not guess:
                    guess, setup = known, PlateSetup.of(known, plate)
                if (keep is None or _still(before, view)) and is_new(view, views, setup):
                    views.append(view)
                    if keep is not None:
                        keep(frame)
                    now = guide(views, setup)
                    _report(now)
                drawn = guide_picture(now, views, view, frame.infrared, setup)
                write_bytes(picture, cv2.imencode(".png", drawn)[1].tobytes())
                if now.wanted is None:
                    break
                before = view
    except KeyboardInterrupt:
        say("stopped by Ctrl-C")
    return now


def rig_frames(running: LiveRig, ending: Ending) -> Iterator[RigFrame]:
    """Run a rig and yield its latest frames until a signal; print warnings while frames are missing.

    A signal does not interrupt the recording of a frame. Raises the error that ended the rig,
    CalibrationError without infrared.
    """
    running.start()
    seen, blind, printed = 0, 0, set[str]()
    try:
        while not running.frames.ended:
            if ending.asked:
                say("stopped by a signal")
                break
            if (latest := running.frames.after(seen, 0.5)) is None:
                wrong = [one for one in rig_warnings(running.health()) if one.kind not in printed]
                printed |= {one.kind for one in wrong}
                say(*(one.text for one in wrong))
                continue
            seen, synced = latest
            blind = 0 if synced.frame.infrared is not None else blind + 1
            if blind == MOST_BLIND:
                raise CalibrationError(
                    f"the depth camera of {running.name!r} gives no infrared, in which the plate is "
                    "found; use one that does"
                )
            yield synced.frame
    finally:
        running.close()
    if running.error is not None:
        raise running.error


def _still(before: PlateView | None, view: PlateView) -> bool:
    if before is None or not {"depth"} <= before.centers_px.keys() & view.centers_px.keys():
        return False
    moved = before.centers_px["depth"] - view.centers_px["depth"]
    return bool(np.linalg.norm(moved, axis=1).max() < STILL_PX)


def _report(now: Guidance) -> None:
    """Print the last view, the precision of the poses (two standard deviations), and the next view."""
    texts = []
    for name, sd in now.found.deviations.items() if now.found else ():
        turn, shift = 2 * sd.rotation_deg.max(), 2 * sd.translation_mm
        texts.append(
            f"the pose of {name} is within {turn:.3f} degrees, {shift[:2].max():.2f} mm across and "
            f"{shift[2]:.2f} mm along the view"
        )
    say("; ".join([f"view {len(now.seen)}: {now.seen[-1].text}", *texts]))
    say("the views suffice" if now.wanted is None else f"now hold the plate {now.wanted.text}")

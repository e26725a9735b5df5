"""Make the animated pictures in docs/images.

xvfb-run -a -s "-screen 0 1600x1000x24" .venv/bin/python docs/animations.py

The correction window is worked by mouse and keys on a person of the virtual rig. The live window shows the
recording frame by frame; rates are left out, because they depend on the machine.
"""

import io
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image
from PySide6.QtCore import QBuffer, QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QWidget

sys.path.insert(0, str(Path(__file__).resolve().parent))
from window import IMAGES, draw, make_labels, open_window, press, wait

from annotate.gui.live.live_window import LiveWindow
from annotate.gui.widgets.theme import DARK
from annotate.gui.window import CorrectionWindow
from annotate.live.pipeline import LivePipeline
from annotate.parts import PART_ID
from annotate.suit.palette import load_suit
from cli.live_view import labelling_by
from sensors.recording.frame_assembly import SyncedFrame
from sensors.recording.playback import Playback
from sensors.rig.frame import RigFrame
from sensors.session.reader import Session
from synth.rig.simulate import suit_path

SHOWN = (900, 562)  # px of an animation
QUALITY = 55  # of the WebP frames; untuned
PACE_MS = 600  # of a frame in the live window; untuned


class Film:
    """Grabbed pictures of a window, and the milliseconds of each."""

    def __init__(self, window: QWidget) -> None:
        self.window = window
        self.frames: list[Image.Image] = []
        self.durations: list[int] = []

    def take(self, milliseconds: int) -> None:
        """Grab the window."""
        buffer = QBuffer()
        buffer.open(QBuffer.OpenModeFlag.ReadWrite)
        self.window.grab().save(buffer, "PNG")
        image = Image.open(io.BytesIO(bytes(buffer.data()))).convert("RGB")
        self.frames.append(image.resize(SHOWN, Image.Resampling.LANCZOS))
        self.durations.append(milliseconds)

    def save(self, name: str) -> None:
        """Write the animation, which loops."""
        first, *rest = self.frames
        options = {"duration": self.durations, "loop": 0, "quality": QUALITY, "method": 6}
        first.save(IMAGES / name, save_all=True, append_images=rest, **options)


def correction(folder: Path) -> None:
    """Film a click on a piece, a loop, undo, an accepted frame, and the next frame in temperatures."""
    window = open_window(folder, "dark")
    film, canvas = Film(window), window.views.cloud.plotter
    film.take(900)
    handle, left, plain = window.windowHandle(), Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier
    press(window, "piece")
    press(window, "left_upper_leg")
    place = canvas.mapTo(window, middle_of(window, "right_upper_leg"))
    for _ in range(2):
        QTest.mouseMove(handle, place)
        wait(0.5)
        film.take(700)
        QTest.mouseClick(handle, left, plain, place)
        wait(0.5)
        film.take(700)
    for _ in range(2):
        press(window, "undo")
        wait(0.3)
        film.take(500)
    press(window, "lasso")
    press(window, "right_upper_leg")
    middle = middle_of(window, "left_upper_leg")
    angles = np.linspace(0.3, 6.0, 40)
    ring = [middle + QPoint(round(62 * np.cos(a)), round(40 * np.sin(a))) for a in angles]
    draw(window, ring[:1])
    for first in range(1, 40, 8):
        for point in ring[first : first + 8]:
            QTest.mouseMove(handle, canvas.mapTo(window, point))
        wait(0.2)
        film.take(180)
    QTest.mouseRelease(handle, left, plain, canvas.mapTo(window, ring[-1]))
    wait(0.6)
    film.take(900)
    for name, milliseconds in (("undo", 700), ("accept", 1000), ("colouring", 900), ("colouring", 900)):
        press(window, name)
        wait(0.8)
        film.take(milliseconds)
    film.save("window.webp")
    window.close()


def middle_of(window: CorrectionWindow, part: str) -> QPoint:
    """Return the middle of a part in the cloud's picture."""
    pixels = np.flatnonzero(window.edits.parts.ravel() == PART_ID[part])
    x, y = np.nanmedian(window.views.cloud.view().xy_px[pixels], axis=0)
    return QPoint(round(x), round(y))


class Stepped(Playback):
    """Recording whose frames come by ``show``."""

    def show(self, frame: RigFrame) -> None:
        """Put a frame now."""
        self.frames.put(SyncedFrame(frame, frame.stamp_ns, time.monotonic_ns()))


def live(path: Path) -> None:
    """Film every frame of a recording in the live window."""
    session = Session(path)
    rig = Stepped(session)
    pipeline = LivePipeline(rig, labelling_by(load_suit(suit_path(path))))
    window = LiveWindow(pipeline, iter(()), DARK, "mia")
    window.resize(1280, 800)
    window.show()
    pipeline.start()
    film = Film(window)
    for number, frame in enumerate(session):
        rig.show(frame)
        while window.shown <= number:
            wait(0.05)
        wait(0.3)
        window._timer.stop()
        body_pose = window._frame.body_pose
        said = (
            "no person" if body_pose is None else f"{body_pose.posture}, facing {body_pose.facing_deg:+.0f}°"
        )
        window.facts.setText(f"person: mia   ·   {said}")
        wait(0.05)
        film.take(PACE_MS)
        window._timer.start()
    film.save("live.webp")
    window.close()
    pipeline.close()
    rig.close()


def main() -> None:
    """Make the data and both animations."""
    app = QApplication([])
    with tempfile.TemporaryDirectory() as folder:
        made = make_labels(Path(folder))
        correction(made)
        live(made / "people.mcap")
    del app


if __name__ == "__main__":
    main()

"""Takes the pictures of the correction window in docs/images: xvfb-run -a -s "-screen 0 1600x1000x24" \\
.venv/bin/python docs/window.py

A recording of the virtual rig is labelled, and predicted by the network to compare with; then the
window is worked by mouse and keys.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QKeySequence
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from annotate.correction.correction import Correction
from annotate.gui.commands import bind
from annotate.gui.state.keys import Settings
from annotate.gui.state.point_colors import Look
from annotate.gui.state.scene import SceneReader
from annotate.gui.window import CorrectionWindow
from annotate.labelset.label_set import LabelSet
from annotate.parts import PART_ID

IMAGES = Path(__file__).resolve().parent / "images"
SIZE = (1440, 900)


def main() -> None:
    """Make the data, and take every picture."""
    app = QApplication([])
    with tempfile.TemporaryDirectory() as folder:
        made = make_labels(Path(folder))
        for theme in ("dark", "light"):
            window = open_window(made, theme)
            (dark if theme == "dark" else light)(window)
            window.close()
    del app


def open_window(made: Path, theme: str) -> CorrectionWindow:
    """The correction window over what ``make_labels`` made, in front and drawn."""
    correction = Correction.open(made / "labels", "mia")
    reader = SceneReader(correction, made / "people.mcap", LabelSet.open(made / "network"))
    window = CorrectionWindow(correction, reader, Settings(theme))
    bind(window)
    window.resize(*SIZE)
    window.show()
    window.activateWindow()
    QTest.qWaitForWindowActive(window)
    wait(4.0)
    return window


def make_labels(folder: Path) -> Path:
    """A recording, its automatic labels, and the network's."""
    for command in (
        "simulate people.mcap --frames 12 --subjects 3 --difficulty normal --seed 7",
        "label people.mcap --suit people.suit.toml --out labels",
        "predict people.mcap --out network",
    ):
        subprocess.run([sys.executable, "-m", "cli.main", *command.split()], cwd=folder, check=True)
    return folder


def dark(window: CorrectionWindow) -> None:
    """A lasso in the making; the keys; heat seen from the side."""
    for _ in range(2):
        press(window, "accept")
    press(window, "lasso")
    press(window, "right_upper_leg")
    view = window.views.cloud
    pixels = np.flatnonzero(window.edits.parts.ravel() == PART_ID["left_upper_leg"])
    x, y = np.nanmedian(view.view().xy_px[pixels], axis=0)
    angles = np.linspace(0.3, 6.0, 40)
    ring = [QPoint(round(x + 62 * np.cos(a)), round(y + 40 * np.sin(a))) for a in angles]
    draw(window, ring)
    save(window, "window-lasso.png")
    press(window, "cancel")
    press(window, "help")
    save(window, "window-keys.png")
    press(window, "help")
    window.views.set_look(window.views.cloud, Look("temperature", tint=0.25))
    turn(window, QPoint(110, 40))
    save(window, "window-heat.png")


def light(window: CorrectionWindow) -> None:
    """Parts in the light theme; where the network says otherwise."""
    save(window, "window-light.png")
    press(window, "order")
    window.views.set_look(window.views.cloud, Look("disagreement"))
    press(window, "doubt")
    save(window, "window-difference.png")


def press(window: CorrectionWindow, name: str) -> None:
    """Strike the key of a command, and wait for what it starts."""
    combination = QKeySequence(window.settings.key(name))[0]
    QTest.keyClick(window, combination.key(), combination.keyboardModifiers())
    while window.background.busy:
        wait(0.05)


def draw(window: CorrectionWindow, places: list[QPoint]) -> None:
    """Press the left button and move through places of the cloud; it is not released."""
    handle, canvas = window.windowHandle(), window.views.cloud.plotter
    points = [canvas.mapTo(window, place) for place in places]
    QTest.mouseMove(handle, points[0])
    QTest.mousePress(handle, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, points[0])
    for point in points[1:]:
        QTest.mouseMove(handle, point)


def turn(window: CorrectionWindow, by: QPoint) -> None:
    """Drag the cloud with the right button."""
    handle, start = window.windowHandle(), QPoint(600, 450)
    right, plain = Qt.MouseButton.RightButton, Qt.KeyboardModifier.NoModifier
    QTest.mousePress(handle, right, plain, start)
    QTest.mouseMove(handle, start + by)
    QTest.mouseRelease(handle, right, plain, start + by)


def wait(seconds: float) -> None:
    """Let the window work, and its threads (``QTest.qWait`` would not)."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        QApplication.processEvents()
        time.sleep(0.01)


def save(window: CorrectionWindow, name: str) -> None:
    """Write what the window shows."""
    wait(0.8)
    window.grab().save(str(IMAGES / name))


if __name__ == "__main__":
    main()

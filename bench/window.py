"""Speed of the window on a made label set, drawn on the screen there is or under xvfb-run (llvmpipe).

python -m bench.window

Every time is from the event to the repainted screen; where the window is blocked, the CPU time of its longest
event. The second column of seconds is the bar.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from sensors.rig.camera import Intrinsics

STROKE_S, NEXT_S, MOVE_S, BLOCK_S = 0.1, 0.3, 0.1, 0.05
FRAMES = 8


def bench() -> list[tuple[str, float, float]]:
    """Return rows (name, seconds, seconds allowed), measured in a process of its own on Xvfb."""
    command = [sys.executable, "-m", "bench.window"]
    if not os.environ.get("DISPLAY"):
        if not shutil.which("xvfb-run"):
            return []
        command = ["xvfb-run", "-a", "-s", "-screen 0 1600x1000x24", *command]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    rows = (line.split("\t") for line in done.stdout.splitlines() if line.count("\t") == 2)
    return [(what, float(seconds), float(bar)) for what, seconds, bar in rows]


def main() -> None:
    """Measure every action and print a line for each."""
    with tempfile.TemporaryDirectory() as folder:
        for shape, what in (((424, 512), "217,088 points"), ((1000, 1000), "1,000,000 points")):
            path = Path(folder) / str(shape[0])
            person = made_set(path, shape, FRAMES if shape[0] == 424 else 2)
            for name, seconds, bar in measured(path, shape[0] == 424):
                print(f"window, {what}, {person:,} of the person: {name}\t{seconds}\t{bar}", flush=True)


def made_set(path: Path, shape: tuple[int, int], frames: int) -> int:
    """Write a wall and a rounded figure in front of it; return the figure's pixels, about 20,000."""
    height, width = shape
    focal = 0.713 * width
    labels = LabelSet.create(path, Intrinsics(width, height, focal, focal, width / 2, height / 2), {})
    for i in range(frames):
        depth, parts = figure(height, width, 0.004 * i)
        labels.write(FrameLabels(f"{i:06d}", depth, parts, np.ones(shape, np.float32)))
    return int((parts > 0).sum())


def figure(height: int, width: int, shift: float) -> tuple[NDArray[np.uint16], NDArray[np.uint8]]:
    """Return depth and parts of eleven ellipsoids arranged like a body."""
    v, u = np.mgrid[:height, :width] / height
    u = u - width / height / 2 - shift
    depth = np.full((height, width), 3000.0)
    parts = np.zeros((height, width), np.uint8)
    across = (0, 0, 0.11, -0.11, 0.15, -0.15, 0, 0.045, -0.045, 0.05, -0.05)
    down = (0.22, 0.36, 0.35, 0.35, 0.46, 0.46, 0.48, 0.59, 0.59, 0.74, 0.74)
    radii = ((0.042, 0.056), (0.08, 0.1), *((0.03, 0.07),) * 4, (0.08, 0.05), *((0.04, 0.09),) * 4)
    for part, (x, y, (rx, ry)) in enumerate(zip(across, down, radii, strict=True), 1):
        inside = 1 - ((u - x) / rx) ** 2 - ((v - y) / ry) ** 2
        mask = inside > 0
        depth[mask] = 2000 - 120 * np.sqrt(inside[mask])
        parts[mask] = part
    noise = np.random.default_rng(0).normal(0, 2, depth.shape)
    return (depth + noise).astype(np.uint16), parts


def measured(path: Path, small: bool) -> Iterator[tuple[str, float, float]]:
    """Measure strokes, pointer moves and next frames, from the event to the screen."""
    from PySide6.QtCore import QPoint, Qt
    from PySide6.QtTest import QTest

    from tests.helpers.gui_driver import Driver

    app = noting_application()
    driver = Driver(path, size=(1440, 900))
    driver.key("lasso")
    middle = driver.place(driver.middle_of(2))

    def stroke(i: int) -> None:
        driver.key(("head", "hip", "torso")[i % 3])
        release = driver.press_and_draw(driver.circle(middle, 40))
        times.append(timed(app, release))

    def move(i: int) -> None:
        place = driver.on_window(middle + QPoint(3 * i, i))
        times.append(timed(app, lambda: QTest.mouseMove(driver.window.windowHandle(), place)))

    def next_frame(i: int) -> None:
        time.sleep(0.5)
        app.longest_s = 0.0
        times.append(timed(app, lambda: driver.key("next")))
        blocks.append(app.longest_s)

    def accept(i: int) -> None:
        time.sleep(0.5)
        app.longest_s = 0.0
        driver.key("accept")
        blocks.append(app.longest_s)

    times: list[float] = []
    blocks: list[float] = []
    repeated(stroke, 9)
    yield "a lasso's effect on the screen", median(times), STROKE_S
    times.clear()
    let_go = driver.press_and_draw([middle], button=Qt.MouseButton.RightButton)
    repeated(move, 15)
    let_go()
    yield "a step of turning the view", median(times), MOVE_S
    if small:
        times.clear()
        repeated(next_frame, FRAMES - 1)
        yield "the next frame, prefetched", median(times), NEXT_S
        yield "longest event of the next frame, CPU", median(blocks), BLOCK_S
        blocks.clear()
        repeated(accept, FRAMES - 1)
        yield "longest event of accepting, CPU", median(blocks), BLOCK_S
    driver.close()


def noting_application() -> Any:
    """Application that measures its events. longest_s: CPU seconds of the longest event since a reset."""
    from PySide6.QtWidgets import QApplication

    class Noting(QApplication):
        longest_s, _began_s = 0.0, 0.0

        def notify(self, receiver: Any, event: Any) -> bool:
            if self._began_s:
                return super().notify(receiver, event)
            self._began_s = time.thread_time()
            try:
                return super().notify(receiver, event)
            finally:
                self.longest_s = max(self.longest_s, time.thread_time() - self._began_s)
                self._began_s = 0.0

    return QApplication.instance() or Noting([])


def repeated(action: Callable[[int], None], times: int) -> None:
    """Run actions one after the other."""
    for i in range(times):
        action(i)


def timed(app: Any, action: Callable[[], None]) -> float:
    """Return the seconds until an action and its repaints are done."""
    started = time.perf_counter()
    action()
    app.processEvents()
    return time.perf_counter() - started


if __name__ == "__main__":
    main()

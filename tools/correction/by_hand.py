"""Corrects frames through the window by mouse and keys alone, as the simulated annotator decides:
python -m tools.correction.by_hand [--frames 50] [--seed 150]

Decisions are ``annotate.effort.annotator``'s. What it would do to an editor becomes events, sent to the
window as the system sends them. Seconds come from the events that were sent, by the keystroke-level model,
and stand beside the seconds that ``annotate.effort`` reckons for the same frames without a window.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QPoint, QPointF, Qt
from PySide6.QtGui import QCursor, QWheelEvent
from PySide6.QtWidgets import QApplication

from annotate.correction.correction import Correction
from annotate.effort.agreement import Agreement
from annotate.effort.annotator import Annotator, correct_set
from annotate.effort.hand import drawn
from annotate.effort.keystrokes import BUTTON_S, EFFECTIVE_WIDTH, KEY_S, MENTAL_S, POINT_S, STEER_S
from annotate.effort.repairs import SCALE
from annotate.gui.commands import BRUSHES_PX
from annotate.gui.state.scene import SceneReader
from annotate.labelset.label_set import LabelSet
from annotate.parts import BACKGROUND, PARTS
from tests.helpers.gui_driver import NO_MODIFIER, SHIFT, Driver

TOLERANCE_PX = 2
WINDOW = (1600, 1150)
PANE_WIDTH = 1250
MIDDLE = Qt.MouseButton.MiddleButton


@dataclass
class Ledger:
    """What was sent, for the keystroke-level model."""

    counts: Counter = field(default_factory=Counter)
    steering_s: float = 0.0

    @property
    def seconds(self) -> float:
        prices = {"key": KEY_S, "point": POINT_S, "button": BUTTON_S, "mental": MENTAL_S}
        return self.steering_s + sum(prices[name] * count for name, count in self.counts.items())


class Hand(Annotator):
    """The annotator at a real window: chooses as always, but moves mouse and keys."""

    def __init__(self, driver: Driver) -> None:
        super().__init__(tolerance_px=TOLERANCE_PX)
        self.driver, self.ledger = driver, Ledger()
        self.pane = driver.window.depth_pane

    # Deciding costs thought

    def _spend(self, editor, activity, seconds) -> None:
        """Nothing is reckoned in advance: what is sent counts."""

    def work_on_frame(self, truth: NDArray[np.uint8]) -> None:
        """Correct the frame that is open, and accept it with Space."""
        self.ledger.counts["mental"] += 1
        desk = self.driver.window.desk
        self.work(AtWindow(desk.editor, self), truth, desk.scene.pieces)

    def _take_back(self, editor, strokes: int) -> None:
        self.ledger.counts["mental"] += 1
        for _ in range(strokes):
            self.key("undo")

    def _carry_out(self, sight, repair, rng) -> int:
        self.ledger.counts["mental"] += 1
        before = len(self.driver.correction.journal)
        for move in repair.moves:
            corners = None if move.corners is None else drawn(move.corners, move.hand, rng)
            self._move(move, corners)
            self._tools = self._tools.set_for(move)
        return len(self.driver.correction.journal) - before

    # Hands

    def _move(self, move, corners) -> None:
        desk = self.driver.window.desk
        if move.part is not None and move.part != desk.part:
            self.key(PARTS[move.part].name)
        if move.kind == "key":
            self._press(move)
        elif move.kind in ("supervoxel", "grow"):
            self._tool("piece")
            place = self.point_at(move.pixel)
            for _ in range(move.clicks):
                self.ledger.counts["button"] += 2
                self.driver.click(place, view=self.pane)
        else:
            self._draw(move, corners)

    def _press(self, move) -> None:
        names = {"swap_left_right": "swap", "to_neighbour": "neighbour"}
        if move.pixel is not None:
            self.driver.hover(self.point_at(move.pixel), view=self.pane)
        name = names.get(move.operation, move.operation)
        self.key(name)
        if self.driver.window.desk.preview:
            self.ledger.counts["mental"] += 1
            self.key(name)

    def _draw(self, move, corners) -> None:
        self._tool(move.kind)
        hand = self.driver.window.hand
        if move.kind == "brush":
            wanted_px = move.radius_px * move.hand.zoom * SCALE
            name, px = min(BRUSHES_PX.items(), key=lambda item: abs(item[1] - wanted_px))
            if hand.radius_px != px:
                self.key(name)
        if move.only is None and move.part != BACKGROUND and hand.room == move.keep_outline:
            self.key("room")
        line = [tuple(corner) for corner in corners]
        if move.kind == "lasso":
            line.append(line[0])
        if move.only is not None:
            self.ledger.counts["key"] += 1
            line = self._started_on(move.only, line, closed=move.kind == "lasso")
        self._bring_into_view(np.array(line), move.hand.zoom)
        self._wheel(line, move.hand.notches)
        places = [self._place(u, v) for u, v in line]
        length = float(np.hypot(*np.diff(np.array(line), axis=0).T).sum())
        self.ledger.counts["point"] += 1
        self.ledger.counts["button"] += 2
        self.ledger.steering_s += STEER_S * length / (EFFECTIVE_WIDTH * move.hand.sd_px)
        self.driver.drag(places, SHIFT if move.only is not None else NO_MODIFIER, view=self.pane)
        self._wheel(line, -move.hand.notches)

    def _wheel(self, line, notches: int) -> None:
        """Bring the image nearer, or farther again, about the middle of what is drawn."""
        if notches:
            self.ledger.counts["key"] += abs(notches)
            turn(self.driver, self._place(*middle_of(np.array(line))), notches)

    def _bring_into_view(self, line: NDArray[np.float64], zoom: float) -> None:
        """Shift the image where what is to be drawn would leave the pane."""
        middle = middle_of(line)
        at = self._place(*middle)
        reach = (np.ptp(line, axis=0) / 2 + 2) * zoom * self._scale
        width, height = self.pane.width(), self.pane.height()
        if reach[0] < at.x() < width - reach[0] and reach[1] < at.y() < height - reach[1]:
            return
        self.ledger.counts["point"] += 1
        self.ledger.counts["button"] += 2
        center = QPointF(width / 2, height / 2)
        # In steps that stay on the pane: the patch itself may lie beyond it.
        for _ in range(8):
            away = center - self._place(*middle)
            if max(abs(away.x()), abs(away.y())) < 2:
                return
            step = QPointF(
                *(
                    float(np.clip(d, -w / 3, w / 3))
                    for d, w in zip((away.x(), away.y()), (width, height), strict=True)
                )
            )
            self.driver.drag([center, center + step / 2, center + step], view=self.pane, button=MIDDLE)

    def _started_on(self, part: int, line, closed: bool):
        """The same shape, begun on the part that alone is to be replaced."""
        v, u = np.nonzero((self.driver.parts == part) & (self.driver.window.desk.scene.labels.depth_mm > 0))
        away = np.hypot(u - line[0][0], v - line[0][1])
        start = (float(u[away.argmin()]), float(v[away.argmin()]))
        return [start, *line, start] if closed else [start, *line]

    def _tool(self, name: str) -> None:
        if self.driver.window.hand.tool != name:
            self.key(name)

    def key(self, name: str) -> None:
        """Strike a key; Ctrl or Shift with it is one more."""
        self.ledger.counts["key"] += 1 + self.driver.window.settings.key(name).count("+")
        self.driver.key(name)

    def point_at(self, pixel: int) -> QPoint:
        """Move the mouse to a pixel."""
        v, u = divmod(pixel, self.driver.parts.shape[1])
        self._bring_into_view(np.array([[u, v]], np.float64), zoom=1.0)
        self.ledger.counts["point"] += 1
        return self.driver.place(pixel, self.pane)

    @property
    def _scale(self) -> float:
        return self.pane.place_of(1).x() - self.pane.place_of(0).x()

    def _place(self, u: float, v: float) -> QPointF:
        return self.pane.place_of(0) + QPointF(u, v) * self._scale


class AtWindow:
    """An editor whose verdict is the key in the window."""

    def __init__(self, editor, hand: Hand) -> None:
        self._editor, self._hand = editor, hand

    def __getattr__(self, name: str):
        return getattr(self._editor, name)

    def judge(self, verdict: str) -> None:
        self._hand.key(verdict)


def middle_of(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """The middle (2,) of a drawn line's box."""
    return (line.min(axis=0) + line.max(axis=0)) / 2


def main() -> None:
    """Make the recording, correct it twice, and print what came of it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--frames", type=int, default=50)
    parser.add_argument("--seed", type=int, default=150)
    parser.add_argument("--difficulty", default="hard")
    options = parser.parse_args()
    if not os.environ.get("DISPLAY"):
        os.execvp(
            "xvfb-run", ["xvfb-run", "-a", "-s", "-screen 0 1700x1300x24", sys.executable, *sys.orig_argv[1:]]
        )
    with tempfile.TemporaryDirectory() as folder:
        path = make(Path(folder), options)
        shutil.copytree(path / "labels", path / "labels2")
        reckoned = without_window(path)
        rows = at_window(path)
    report(rows, reckoned)


def make(folder: Path, options) -> Path:
    simulate = f"simulate r.mcap --frames {options.frames} --subjects 5 --difficulty {options.difficulty}"
    for command in (f"{simulate} --seed {options.seed}", "label r.mcap --suit r.suit.toml --out labels"):
        subprocess.run([sys.executable, "-m", "cli.main", *command.split()], cwd=folder, check=True)
    return folder


def without_window(path: Path) -> dict[str, float]:
    """Seconds by frame as ``effort`` reckons them."""
    annotator = Annotator(tolerance_px=TOLERANCE_PX)
    with Correction.open(path / "labels2", "simulated", clock=annotator.clock) as correction:
        reader = SceneReader(correction, path / "r.mcap")
        truth = LabelSet.open(path / "r.truth")
        efforts = correct_set(correction, truth, annotator, lambda frame_id: reader.read(frame_id).cloud)
        return {effort.corrected.frame_id: effort.seconds for effort in efforts}


def at_window(path: Path) -> list[tuple[str, float, float, float, float]]:
    """Frame, agreement before and after, strictly after, and seconds by the events sent."""
    app = QApplication([])
    QCursor.setPos(1690, 1290)
    driver, truth, rows = (
        Driver(path / "labels", path / "r.mcap", size=WINDOW),
        LabelSet.open(path / "r.truth"),
        [],
    )
    driver.window.panes.setSizes([WINDOW[0] - PANE_WIDTH, PANE_WIDTH])
    driver.window.palette_.hide()
    driver.settle()
    hand = Hand(driver)
    for frame_id in driver.correction.labels.frame_ids:
        driver.window.open_frame(frame_id)
        driver.settle()
        zoom(driver)
        known = truth.read(frame_id)
        true, valid = known.parts, known.depth_mm > 0
        agreement, strict = Agreement(true, valid, TOLERANCE_PX), Agreement(true, valid)
        before, spent = agreement.of(driver.parts), hand.ledger.seconds
        hand.work_on_frame(true)
        after = driver.correction.frame(frame_id).parts
        rows.append((frame_id, before, agreement.of(after), strict.of(after), hand.ledger.seconds - spent))
        print(*(f"{x:.3f}" if isinstance(x, float) else x for x in rows[-1]), flush=True)
    print(dict(hand.ledger.counts), f"steering {hand.ledger.steering_s:.0f} s")
    driver.close()
    del app
    return rows


def zoom(driver: Driver) -> None:
    """Turn the wheel until a pixel of the depth image is about SCALE pixels of the screen."""
    pane = driver.window.depth_pane
    pane.fit()
    steps = round(float(np.log(SCALE / (pane.place_of(1).x() - pane.place_of(0).x())) / np.log(1.2)))
    turn(driver, QPointF(pane.width() / 2, pane.height() / 2), steps)


def turn(driver: Driver, at: QPointF, notches: int) -> None:
    """Turn the wheel over a place of the depth image's pane."""
    pane = driver.window.depth_pane
    event = QWheelEvent(
        at,
        pane.mapToGlobal(at),
        QPoint(),
        QPoint(0, 120 * notches),
        Qt.MouseButton.NoButton,
        NO_MODIFIER,
        Qt.ScrollPhase.NoScrollPhase,
        False,
    )
    QApplication.sendEvent(pane, event)
    driver.settle()


def report(rows: list[tuple[str, float, float, float, float]], reckoned: dict[str, float]) -> None:
    before, after, strict, seconds = (np.array([row[k] for row in rows]) for k in (1, 2, 3, 4))
    expected = np.array([reckoned[row[0]] for row in rows])
    print(
        f"frames {len(rows)}, agreement {before.mean():.4f} -> {after.mean():.4f}, strict {strict.mean():.4f}"
    )
    print(f"at least 99 %: {(after >= 0.99 - 1e-9).sum()} of {len(rows)}; least {after.min():.4f}")
    print(f"seconds at the window: total {seconds.sum():.0f}, median {median(seconds):.1f}")
    print(f"seconds by effort.py: total {expected.sum():.0f}, median {median(expected):.1f}")
    print(f"ratio {seconds.sum() / expected.sum():.3f}")


if __name__ == "__main__":
    main()

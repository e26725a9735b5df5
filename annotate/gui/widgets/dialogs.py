"""Dialogs: the reason for a rejection, exports, and choices when a file or the disk fails."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeyEvent, QKeySequence, QShortcut
from PySide6.QtWidgets import (
    QDialog,
    QFileDialog,
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from annotate.correction.correction import Correction, RestorableError
from annotate.gui.state.outcome import strokes_text
from annotate.gui.widgets.building_blocks import laid, named
from sensors.errors import CloudError

REASONS = (
    "Body cut off or hidden",
    "Depth missing or noisy",
    "Thermal and depth images do not match",
    "Several people touch",
    "Parts cannot be distinguished",
)
FORMAT_TITLES = {
    "pairs": "Image pairs (PNG)",
    "mmseg": "MMSegmentation",
    "coco": "COCO",
    "cvat": "CVAT",
    "pcd": "Point clouds (PCD)",
    "ply": "Point clouds (PLY)",
    "semantic-kitti": "SemanticKITTI",
    "parquet": "Parquet",
}


class ReasonDialog(QDialog):
    """Question for the reason of a rejection: a button for each of REASONS, and a field for own words.

    reason: the given one, or "". Typed text goes into the field, also while a button has the focus.
    """

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setWindowTitle("Reject the frame")
        self.setMinimumWidth(360)
        self.reason = ""
        buttons = [QPushButton(f"{i}   {reason}", autoDefault=False) for i, reason in enumerate(REASONS, 1)]
        for number, (button, reason) in enumerate(zip(buttons, REASONS, strict=True), 1):
            button.setStyleSheet("text-align: left; padding: 8px 12px")
            button.clicked.connect(partial(self._choose, reason))
            QShortcut(QKeySequence(str(number)), self, button.click)
        self.words = QLineEdit(placeholderText="…or in your own words, then Enter", maxLength=200)
        self.words.setAccessibleName("Reason in your own words")
        self.words.returnPressed.connect(lambda: self._choose(self.words.text()))
        question = named(QLabel("Why should this frame not be used?"), "title")
        keep = named(QLabel("Esc keeps the frame"), "quiet")
        items = question, *buttons, self.words, keep
        laid(QVBoxLayout(self), *items, gap=8, margins=(20, 18, 20, 18))

    def _choose(self, reason: str, _: bool = False) -> None:
        if reason.strip():
            self.reason = reason.strip()
            self.accept()

    def keyPressEvent(self, event: QKeyEvent) -> None:  # noqa: N802
        """Qt's hook: write letters that no widget takes into the field."""
        if event.text().strip() and event.text().isprintable():
            self.words.setFocus()
            self.words.insert(event.text())
        else:
            super().keyPressEvent(event)


def ask_reason(parent: QWidget) -> str | None:
    """Return the reason of a rejection: one of REASONS, or own words; None keeps the frame."""
    dialog = ReasonDialog(parent)
    dialog.exec()
    return dialog.reason or None


def show_keys(parent: QWidget, keys: Sequence[tuple[str, str]]) -> None:
    """Show keys and their effects, until Escape, Return or F1 is pressed."""
    dialog = QDialog(parent)
    dialog.setWindowTitle("All keys")
    grid = QGridLayout()
    grid.setHorizontalSpacing(14)
    for row, (key, does) in enumerate(keys):
        grid.addWidget(named(QLabel(key), "key"), row, 0, Qt.AlignmentFlag.AlignRight)
        grid.addWidget(QLabel(does), row, 1)
    close = QPushButton("Close", default=True)
    close.clicked.connect(dialog.accept)
    QShortcut(QKeySequence("F1"), dialog, dialog.accept)
    laid(QVBoxLayout(dialog), grid, close, gap=14, margins=(20, 18, 20, 18))
    dialog.exec()


def _ask(parent: QWidget | None, title: str, text: str, yes: str, no: str) -> bool:
    """Ask a question with two answers; Escape is ``no``."""
    dialog = QDialog(parent)
    dialog.setWindowTitle(title)
    # Plain, because a file's name is not markup.
    words = QLabel(text, textFormat=Qt.TextFormat.PlainText, wordWrap=True)
    words.setMinimumWidth(440)
    decline, agree = QPushButton(no), QPushButton(yes, default=True)
    decline.clicked.connect(dialog.reject)
    agree.clicked.connect(dialog.accept)
    answers = laid(QHBoxLayout(), None, decline, agree, gap=12)
    heading = named(QLabel(title), "title")
    laid(QVBoxLayout(dialog), heading, words, answers, gap=12, margins=(22, 20, 22, 18))
    return dialog.exec() == QDialog.DialogCode.Accepted


def ask_export(parent: QWidget, formats: Sequence[str]) -> tuple[str, Path] | None:
    """Ask for the format and the folder of an export; None cancels."""
    dialog = QDialog(parent)
    dialog.setWindowTitle("Export")
    question = named(QLabel("Export format"), "title")
    given: list[str] = []

    def choose(name: str) -> None:
        given.append(name)
        dialog.accept()

    buttons = [QPushButton(FORMAT_TITLES.get(name, name), autoDefault=False) for name in formats]
    for item, name in zip(buttons, formats, strict=True):
        item.clicked.connect(partial(choose, name))
    laid(QVBoxLayout(dialog), question, *buttons, gap=8, margins=(20, 18, 20, 18))
    dialog.exec()
    if not given:
        return None
    folder = QFileDialog.getSaveFileName(parent, f"New folder for {given[0]}", f"{given[0]}-export")[0]
    return (given[0], Path(folder)) if folder else None


def restored(correction: Correction, frame_id: str, error: CloudError, parent: QWidget | None) -> bool:
    """Rebuild a broken frame if that is possible and the user agrees; return whether it was rebuilt."""
    if not isinstance(error, RestorableError) or correction.read_only:
        return False
    text = (
        f"{error}\n\nThe labels from before the first correction and every stroke since then are intact. "
        "Restoring rebuilds the broken files from them; nothing else is touched."
    )
    if not _ask(parent, "A broken frame can be restored", text, "Restore the frame", "Leave it"):
        return False
    correction.restore(frame_id)
    return True


def ask_retry(parent: QWidget | None, error: str, strokes: int) -> bool:
    """Ask whether to write refused strokes again now, or to go on until the next stroke."""
    text = (
        f"{error}\n\n{strokes_text(strokes)} kept in this window; nothing is lost while it is open. "
        "Free some space, then try again; or go on: every stroke tries again."
    )
    return _ask(parent, "The disk is full or cannot be written", text, "Try again", "Go on")


def ask_close(parent: QWidget | None, strokes: int) -> bool:
    """Ask whether to close although strokes would be lost."""
    text = (
        f"{strokes_text(strokes)} could not be written and would be lost. Free some space first, if you can."
    )
    return _ask(parent, "Close and lose strokes?", text, "Close and lose them", "Stay")

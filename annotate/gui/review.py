"""What the window asks: the reason for a rejection, and what to do when a file or the disk fails."""

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import (
    QDialog,
    QHBoxLayout,
    QLabel,
    QLineEdit,
    QMessageBox,
    QPushButton,
    QVBoxLayout,
    QWidget,
)

from annotate.gui.theme import named

REASONS = (
    "Body cut off or hidden",
    "Depth missing or noisy",
    "Thermal and depth do not fit",
    "Several people touch",
    "Parts cannot be told",
)


class RejectDialog(QDialog):
    """Why a frame is not to be used: one of REASONS by its number, or words of one's own."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.reason = ""
        self.setWindowTitle("Reject the frame")
        column = QVBoxLayout(self)
        column.setContentsMargins(20, 18, 20, 18)
        column.setSpacing(8)
        column.addWidget(named(QLabel("Why is this frame not to be used?"), "title"))
        for number, reason in enumerate(REASONS, 1):
            button = QPushButton(f"{number}   {reason}", autoDefault=False)
            button.setStyleSheet("text-align: left; padding: 8px 12px")
            button.clicked.connect(lambda _=False, reason=reason: self._choose(reason))
            QShortcut(QKeySequence(str(number)), self, lambda reason=reason: self._choose(reason))
            column.addWidget(button)
        self.words = QLineEdit(placeholderText="…or in your own words, then Enter", maxLength=200)
        self.words.setFocusPolicy(Qt.FocusPolicy.ClickFocus)
        self.words.returnPressed.connect(lambda: self._choose(self.words.text()))
        column.addWidget(self.words)
        column.addWidget(named(QLabel("Esc keeps the frame"), "quiet"))
        self.setMinimumWidth(360)

    def _choose(self, reason: str) -> None:
        if reason.strip():
            self.reason = reason.strip()
            self.accept()


def _ask(parent: QWidget | None, title: str, text: str, yes: str, no: str) -> bool:
    """A question with two answers; Escape is ``no``."""
    dialog = QDialog(parent)
    dialog.setWindowTitle(title)
    column = QVBoxLayout(dialog)
    column.setContentsMargins(22, 20, 22, 18)
    column.setSpacing(12)
    column.addWidget(named(QLabel(title), "title"))
    # Plain: a file's name is no markup.
    words = QLabel(text, textFormat=Qt.TextFormat.PlainText, wordWrap=True)
    words.setMinimumWidth(440)
    column.addWidget(words)
    row = QHBoxLayout()
    row.addStretch(1)
    column.addLayout(row)
    for label, slot in ((no, dialog.reject), (yes, dialog.accept)):
        button = QPushButton(label, default=label == yes)
        button.clicked.connect(slot)
        row.addWidget(button)
    return dialog.exec() == QDialog.DialogCode.Accepted


def ask_restore(parent: QWidget | None, error: str) -> bool:
    """A frame's file is corrupt and can be rebuilt."""
    text = (
        f"{error}\n\nThe labels from before the first correction and every stroke since are there. "
        "Restoring replaces the broken files by what they add up to; nothing else is touched."
    )
    return _ask(parent, "A frame is broken and can be restored", text, "Restore the frame", "Leave it")


def ask_retry(parent: QWidget | None, error: str, strokes: int) -> bool:
    """The disk refuses to take strokes. True to try again, False to go on and try at the next stroke."""
    text = (
        f"{error}\n\n{strokes} strokes are kept in this window and nothing is lost while it is open. "
        "Free some space, then try again; or go on: every further stroke tries again too."
    )
    return _ask(parent, "The disk takes no more", text, "Try again", "Go on")


def ask_close(parent: QWidget | None, strokes: int) -> bool:
    """Closing would lose strokes. True to close all the same."""
    text = f"{strokes} strokes could not be written and would be lost. Free some space first, if you can."
    return _ask(parent, "Close and lose strokes?", text, "Close and lose them", "Stay")


def tell(parent: QWidget | None, title: str, text: str) -> None:
    """Something went wrong; nothing to choose."""
    box = QMessageBox(parent)
    box.setWindowTitle(title)
    box.setTextFormat(Qt.TextFormat.PlainText)
    box.setText(text)
    box.exec()

"""Dialogs: the reason for a rejection, and what to do when a file or the disk fails."""

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import QDialog, QHBoxLayout, QLabel, QLineEdit, QPushButton, QVBoxLayout, QWidget

from annotate.gui.theme import named

REASONS = (
    "Body cut off or hidden",
    "Depth missing or noisy",
    "Thermal and depth images do not match",
    "Several people touch",
    "Parts cannot be told apart",
)


class RejectDialog(QDialog):
    """Why a frame is not to be used: one of REASONS by its number, or a text."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.reason = ""
        self.setWindowTitle("Reject the frame")
        column = QVBoxLayout(self)
        column.setContentsMargins(20, 18, 20, 18)
        column.setSpacing(8)
        column.addWidget(named(QLabel("Why should this frame not be used?"), "title"))
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
    """Whether to rebuild a frame whose file is corrupt."""
    text = (
        f"{error}\n\nThe labels from before the first correction and every stroke since then are intact. "
        "Restoring rebuilds the broken files from them; nothing else is touched."
    )
    return _ask(parent, "A broken frame can be restored", text, "Restore the frame", "Leave it")


def ask_retry(parent: QWidget | None, error: str, strokes: int) -> bool:
    """Whether to write strokes that the disk refused again now, or to go on until the next stroke."""
    text = (
        f"{error}\n\n{strokes} strokes are kept in this window and nothing is lost while it is open. "
        "Free some space, then try again; or go on: every stroke tries again."
    )
    return _ask(parent, "The disk is full or cannot be written", text, "Try again", "Go on")


def ask_close(parent: QWidget | None, strokes: int) -> bool:
    """Whether to close although strokes would be lost."""
    text = f"{strokes} strokes could not be written and would be lost. Free some space first, if you can."
    return _ask(parent, "Close and lose strokes?", text, "Close and lose them", "Stay")

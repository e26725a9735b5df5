"""Dialogs: the reason for a rejection, exports, and choices when a file or the disk fails."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence, QShortcut
from PySide6.QtWidgets import (
    QComboBox,
    QDialog,
    QFileDialog,
    QGridLayout,
    QInputDialog,
    QLabel,
    QMessageBox,
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


def ask_reason(parent: QWidget) -> str | None:
    """Return the reason of a rejection: one of REASONS, or the user's own text; None cancels."""
    dialog = QInputDialog(parent)
    dialog.setWindowTitle("Reject the frame")
    dialog.setLabelText("Reason for the rejection: choose one, or type own words")
    dialog.setComboBoxItems(list(REASONS))
    dialog.setComboBoxEditable(True)
    box = dialog.findChild(QComboBox)
    assert box is not None
    # Own words end with Enter, which would take a completion.
    box.setCompleter(None)  # type: ignore[arg-type]
    box.setCurrentIndex(-1)
    accepted = dialog.exec() == QDialog.DialogCode.Accepted
    return dialog.textValue().strip() or None if accepted else None


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
    # Plain, because a file's name is not markup.
    box = QMessageBox(parent, text=title, informativeText=text, textFormat=Qt.TextFormat.PlainText)
    agree = box.addButton(yes, QMessageBox.ButtonRole.AcceptRole)
    box.setEscapeButton(box.addButton(no, QMessageBox.ButtonRole.RejectRole))
    box.setDefaultButton(agree)
    box.exec()
    return box.clickedButton() is agree


def ask_export(parent: QWidget, formats: Mapping[str, str]) -> tuple[str, Path] | None:
    """Ask for format and folder of an export; None cancels. formats: titles by name."""
    titles = list(formats.values())
    chosen, given = QInputDialog.getItem(parent, "Export", "Export format", titles, 0, False)
    if not given:
        return None
    name = list(formats)[titles.index(chosen)]
    folder = QFileDialog.getSaveFileName(parent, f"New folder for {name}", f"{name}-export")[0]
    return (name, Path(folder)) if folder else None


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
    """Ask whether to write strokes again after the disk refused; return False to wait for the next stroke."""
    text = (
        f"{error}\n\n{strokes_text(strokes)} kept in this window; nothing is lost while it is open. "
        "Free some space, then try again; or go on: every stroke tries again."
    )
    return _ask(parent, "The disk is full or cannot be written", text, "Try again", "Go on")


def ask_close(parent: QWidget | None, strokes: int) -> bool:
    """Ask whether to close although strokes would be lost; return the answer."""
    text = (
        f"{strokes_text(strokes)} could not be written and would be lost. Free some space first, if you can."
    )
    return _ask(parent, "Close and lose strokes?", text, "Close and lose them", "Stay")

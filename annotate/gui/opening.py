"""Opening frames: the first one that can be read, and broken ones restored where the user agrees."""

from PySide6.QtWidgets import QWidget

from annotate.correction.correction import Correction, RestorableError
from annotate.gui.state.frame_order import Opened, Walk
from annotate.gui.widgets.dialogs import ask_restore
from sensors.errors import CloudError


def first(walk: Walk) -> Opened:
    """The first frame that can be opened. Raises what opening the first one raised when none can."""
    error: CloudError | None = None
    for frame_id in walk.first():
        for _ in range(2):
            try:
                return walk.begin(walk.read(frame_id), walk.parts_before(frame_id))
            except CloudError as reason:
                error = error or reason
                if not restored(walk.correction, frame_id, reason, None):
                    break
    assert error is not None
    raise error


def restored(correction: Correction, frame_id: str, error: CloudError, parent: QWidget | None) -> bool:
    """Whether a broken frame was rebuilt because the user wants it."""
    if not isinstance(error, RestorableError) or correction.read_only:
        return False
    if not ask_restore(parent, str(error)):
        return False
    correction.restore(frame_id)
    return True

"""Cast (set of synthetic people) in a manifest, and the refusal to train on a cast reserved for
evaluation.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sensors.errors import CloudError
from sensors.session.messages import CAST

TRAINING = "training"


def cast_note(cast: str) -> dict[str, str]:
    """Return the manifest entry that names a cast; empty for the training cast."""
    return {} if cast == TRAINING else {CAST: cast}


def cast_of(info: Mapping[str, Any]) -> str:
    """Return the cast of a manifest or of a session's metadata."""
    return str(info.get(CAST, TRAINING))


def known_people_note(info: Mapping[str, Any]) -> str:
    """Return a note for a truth that shows the training cast; "" for another cast and for real people.

    info: manifest of the virtual rig's truth or of a dataset.
    """
    synthetic = info.get("made_by") == "simulate" or "preset" in info
    if not synthetic or cast_of(info) != TRAINING:
        return ""
    return (
        "the truth shows the training cast, so scores of shipped networks are too good; make it by "
        "simulate --cast judge or synth generate --cast judge"
    )


def check_trainable(path: Path, info: Mapping[str, Any]) -> None:
    """Raise CloudError for a manifest or metadata of another cast than the training cast."""
    if (cast := cast_of(info)) != TRAINING:
        raise CloudError(
            f"{path} shows people of the cast {cast!r}, reserved for measuring; train on people of the cast "
            f"{TRAINING!r}"
        )

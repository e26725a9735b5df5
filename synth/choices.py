"""Names and numbers that a user chooses people and rooms by, checked before what they name is imported."""

from collections.abc import Collection

from sensors.errors import CloudError

SCENES = ("sofa", "chair", "bed", "floor")
"""Places of the virtual rig (``synth.rig.locations``)."""
DIFFICULTIES = ("clean", "normal", "hard")
"""How hard the virtual rig makes it (``synth/data/difficulties.toml``)."""
PRESETS = ("sitting-train", "sitting-test", "recumbent", "upright", "standing", "people")
"""Datasets by name (``synth.images.presets``)."""


def check_choice(what: str, name: str, known: Collection[str]) -> None:
    """Raise CloudError for a name that is not known, naming those that are."""
    if name not in known:
        raise CloudError(f"{what} {name!r} is unknown; use {', '.join(known)}")


def check_rig(frames: int, subjects: int, scene: str, difficulty: str) -> None:
    """Check what is asked of the virtual rig. Raises CloudError for impossible counts or unknown names."""
    if not 1 <= subjects <= frames <= 1_000_000:
        raise CloudError(
            f"{frames} frames of {subjects} subjects are impossible; give at least one frame each"
        )
    check_choice("difficulty", difficulty, DIFFICULTIES)
    check_choice("scene", scene, SCENES)

"""Names that the shell completes; none where the extra that brings them is not installed."""

from contextlib import suppress


def scenes() -> list[str]:
    """Scenes of the virtual rig, and the plate for calibration."""
    with suppress(ImportError):
        from synth.rig.place import SCENES

        return [*SCENES, "plate"]
    return []


def difficulties() -> list[str]:
    """Difficulties of the virtual rig."""
    with suppress(ImportError):
        from synth.rig.difficulty import DIFFICULTIES

        return list(DIFFICULTIES)
    return []


def presets() -> list[str]:
    """Presets of `synth generate`."""
    with suppress(ImportError):
        from synth.images.presets import PRESETS

        return list(PRESETS)
    return []

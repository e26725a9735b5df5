"""What a shell offers at TAB where a name is asked for; nothing where it is not installed."""

from contextlib import suppress

from annotate.exchange.formats import FORMATS


def scenes() -> list[str]:
    """Where the virtual rig's people are, and the plate for calibrating."""
    with suppress(ImportError):
        from synth.rig.place import SCENES

        return [*SCENES, "plate"]
    return []


def difficulties() -> list[str]:
    """How hard the virtual rig makes it."""
    with suppress(ImportError):
        from synth.rig.difficulty import DIFFICULTIES

        return list(DIFFICULTIES)
    return []


def presets() -> list[str]:
    """Datasets that can be generated."""
    with suppress(ImportError):
        from synth.images.presets import PRESETS

        return list(PRESETS)
    return []


def formats() -> list[str]:
    """Formats that labels can be written in."""
    return list(FORMATS)

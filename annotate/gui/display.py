"""Whether there is a screen to show a window on, known without Qt."""

import os

from sensors.errors import CloudError

SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")
"""Variables of the environment, one of which names it."""


def displays() -> list[str]:
    """Names of those ``SCREENS`` that are set. Raises CloudError where none is."""
    names = [name for name in SCREENS if os.environ.get(name)]
    if not names:
        raise CloudError(
            f"there is no screen (neither {' nor '.join(SCREENS)} is set); "
            "start it on a desktop, over ssh -X, or with xvfb-run -a"
        )
    return names

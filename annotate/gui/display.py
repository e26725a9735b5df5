"""Test of screen and graphics in a separate process, because Qt ends the process if they fail.

``python -m annotate.gui.display`` prints the version of OpenGL, such as "4.5", or "0.0" for none. Qt is
imported only in that process.
"""

import os
import subprocess
import sys

from sensors.errors import CloudError

SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")
OPENGL = (3, 2)
"""Least version for VTK."""
TIMEOUT_S = 60


def displays() -> list[str]:
    """Return the names of set environment variables that name a screen. Raises CloudError without any."""
    names = [name for name in SCREENS if os.environ.get(name)]
    if not names:
        raise CloudError(
            f"no screen is set (neither {' nor '.join(SCREENS)}); "
            "start it on a desktop, over ssh -X, or with xvfb-run -a"
        )
    return names


def check_screen() -> None:
    """Check that a window can be shown. Raises CloudError, which names the remedy, if not."""
    names = displays()
    # -P: no module of the folder in which the user stands.
    command = [sys.executable, "-P", "-m", "annotate.gui.display"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    except subprocess.TimeoutExpired as error:
        raise CloudError(
            f"the screen did not answer within {TIMEOUT_S} s; log in on the desktop again, or use xvfb-run -a"
        ) from error
    if "could not connect" in done.stderr:
        screens = " and ".join(f"{name}={os.environ[name]}" for name in names)
        raise CloudError(f"the screen {screens} cannot be reached; log in on the desktop, or use xvfb-run -a")
    if done.returncode:
        why = next((line for line in done.stderr.splitlines() if line.strip()), f"exit {done.returncode}")
        raise CloudError(
            f"Qt cannot start ({why.strip()[:200]}); install what its xcb plugin needs: "
            "apt install libxcb-cursor0 libxkbcommon-x11-0 libxcb-icccm4 libxcb-keysyms1"
        )
    check_opengl(done.stdout.strip())


def check_opengl(version: str) -> None:
    """Check a version such as "2.1". Raises CloudError for one that is too old, and for "0.0"."""
    if tuple(int(n) for n in version.split(".")) < OPENGL:
        found = "no OpenGL" if version == "0.0" else f"OpenGL {version}"
        raise CloudError(
            f"the graphics driver offers {found}, the window needs {OPENGL[0]}.{OPENGL[1]}; "
            "update the driver, or set LIBGL_ALWAYS_SOFTWARE=1 to draw without it"
        )


def main() -> None:
    """Print the version of OpenGL."""
    from PySide6.QtGui import QGuiApplication, QOffscreenSurface, QOpenGLContext, QSurfaceFormat

    app = QGuiApplication([])
    surface_format = QSurfaceFormat()
    surface_format.setVersion(*OPENGL)
    surface_format.setProfile(QSurfaceFormat.OpenGLContextProfile.CoreProfile)
    context, surface = QOpenGLContext(), QOffscreenSurface()
    context.setFormat(surface_format)
    surface.create()
    works = context.create() and context.makeCurrent(surface)
    version = context.format().version() if works else (0, 0)
    sys.stdout.write("{}.{}\n".format(*version))
    del app


if __name__ == "__main__":
    main()

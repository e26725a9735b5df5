"""Compilation of the Kinect v2's shim at first use."""

import hashlib
import os
import shlex
import subprocess
from pathlib import Path
from shutil import which

from sensors.errors import DeviceNotFoundError
from sensors.files.atomic import replacing

SOURCES = Path(__file__).parents[1] / "cpp"
FLAGS = ("-std=c++17", "-O2", "-Wall", "-Wextra", "-shared", "-fPIC", "-pthread")
GUIDE = "build libfreenect2 in five lines: docs/devices.md, Kinect v2"


def built_shim() -> Path:
    """Return the shim in the user's cache, compiled for this libfreenect2 and source.

    Raises DeviceNotFoundError that names the missing part.
    """
    found = _libfreenect2()
    text = b"".join((SOURCES / f"kinect2_shim.{kind}").read_bytes() for kind in ("cpp", "h"))
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "annotate-cloud"
    path = cache / f"kinect2-{hashlib.sha256(text + shlex.join(found).encode()).hexdigest()[:16]}.so"
    if path.exists():
        return path
    compiler = which("c++") or which("g++")
    if compiler is None:
        raise DeviceNotFoundError("the Kinect v2 needs a C++ compiler; apt install g++")
    cache.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        command = [compiler, *FLAGS, str(SOURCES / "kinect2_shim.cpp"), "-o", str(temporary), *found]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            lines = done.stderr.strip().splitlines() or ["no message from the compiler"]
            raise DeviceNotFoundError(
                f"the driver of the Kinect v2 cannot be compiled with libfreenect2 ({lines[0]}); {GUIDE}"
            )
    return path


def _libfreenect2() -> list[str]:
    """Return the compiler's flags for libfreenect2 by pkg-config, with the library's folder."""
    if which("pkg-config") is None:
        raise DeviceNotFoundError(
            "pkg-config, which finds libfreenect2, is not installed; apt install pkg-config"
        )
    command = ["pkg-config", "--cflags", "--libs", "freenect2 >= 0.2"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise DeviceNotFoundError(
            f"libfreenect2 was not found; {GUIDE}, and set PKG_CONFIG_PATH if it is in a folder of its own"
        )
    flags = shlex.split(done.stdout)
    return [*flags, *(f"-Wl,-rpath,{flag[2:]}" for flag in flags if flag.startswith("-L"))]

"""The C interface of sensors/cpp/kinect2_shim.h in ctypes: types, prototypes, and where the library is."""

from ctypes import CDLL, CFUNCTYPE, POINTER, Structure, c_char, c_char_p, c_float, c_int, c_uint32, c_void_p
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from sensors.errors import DeviceNotFoundError

Pointer = Any
"""Any of ctypes' pointer types, which come into being at run time."""

COLOR, INFRARED, DEPTH = 1, 2, 4
"""Frame types (libfreenect2's Frame::Type)."""
INFRARED_PARAMS, COLOR_PARAMS = 9, 26


class Frame(Structure):
    """``k2_frame``: what is known of a frame beside its bytes."""

    _fields_ = [
        (name, c_uint32) for name in ("type", "timestamp", "sequence", "status", "width", "height", "bytes")
    ]


PROTOTYPES: dict[str, Any] = {
    "k2_count": CFUNCTYPE(c_int),
    "k2_serial": CFUNCTYPE(c_int, c_int, POINTER(c_char), c_int),
    "k2_open": CFUNCTYPE(c_void_p, c_char_p),
    "k2_params": CFUNCTYPE(None, c_void_p, POINTER(c_float), POINTER(c_float)),
    "k2_start": CFUNCTYPE(c_int, c_void_p),
    "k2_read": CFUNCTYPE(c_int, c_void_p, c_int, POINTER(Frame), c_void_p, c_uint32),
    "k2_close": CFUNCTYPE(None, c_void_p),
}


class Shim(SimpleNamespace):
    """The functions of ``PROTOTYPES`` by name, C function pointers: the compiled library's, or a twin's."""


def load_shim(path: Path | None = None) -> Shim:
    """The compiled shim, where it was built or at ``path``. Raises DeviceNotFoundError where it is not."""
    # It is no Python module, but lies where one would: an editable installation keeps it elsewhere.
    spec = find_spec("sensors._kinect2")
    if path is None and spec is not None and spec.origin is not None:
        path = Path(spec.origin)
    if path is None or not path.exists():
        raise DeviceNotFoundError(
            "this build cannot drive a Kinect v2 because libfreenect2 was not found; "
            "install libfreenect2 and run: pip install --force-reinstall --no-deps annotate-cloud"
        )
    try:
        library = CDLL(str(path))
        return Shim(**{name: prototype((name, library)) for name, prototype in PROTOTYPES.items()})
    except (OSError, AttributeError) as error:
        raise DeviceNotFoundError(
            f"{path.name} cannot be loaded ({error}); install the libfreenect2 that it was built with"
        ) from error

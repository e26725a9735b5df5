"""The C interface of the vendor's libirdirectsdk.so in ctypes: types, prototypes, and where the library is.

Source: irdirectsdk.h of libirimager (Evocortex), as public bindings of it declare it.
"""

from ctypes import (
    CDLL,
    CFUNCTYPE,
    POINTER,
    Structure,
    c_char_p,
    c_float,
    c_int,
    c_longlong,
    c_uint,
    c_ulong,
    c_ushort,
)
from ctypes.util import find_library
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

from sensors.errors import DeviceNotFoundError


class FrameMetadata(Structure):
    """``EvoIRFrameMetadata``. timestamp: units of 100 ns."""

    _fields_ = [
        ("counter", c_uint),
        ("counterHW", c_uint),
        ("timestamp", c_longlong),
        ("timestampMedia", c_longlong),
        ("flagState", c_int),
        ("tempChip", c_float),
        ("tempFlag", c_float),
        ("tempBox", c_float),
    ]


Pointer = Any
"""Any of ctypes' pointer types, which come into being at run time."""

_SIZE = (POINTER(c_int), POINTER(c_int))
PROTOTYPES: dict[str, Any] = {
    "usb_init": CFUNCTYPE(c_int, c_char_p, c_char_p, c_char_p),
    "get_serial": CFUNCTYPE(c_int, POINTER(c_ulong)),
    "get_thermal_image_size": CFUNCTYPE(c_int, *_SIZE),
    "get_thermal_image_metadata": CFUNCTYPE(c_int, *_SIZE, POINTER(c_ushort), POINTER(FrameMetadata)),
    "set_radiation_parameters": CFUNCTYPE(c_int, c_float, c_float, c_float),
    "terminate": CFUNCTYPE(c_int),
}
"""Each function's name without ``evo_irimager_``; all return 0 on success."""


class DirectLibrary(SimpleNamespace):
    """The functions of ``PROTOTYPES`` by name, as C function pointers: the vendor's library's, or a twin's.

    in_use: whether it has its camera open; it serves one.
    """

    in_use = False


@lru_cache(maxsize=1)
def load_library() -> DirectLibrary:
    """The vendor's library. Raises DeviceNotFoundError where it is not installed."""
    path = find_library("irdirectsdk")
    if path is None:
        raise DeviceNotFoundError(
            "libirdirectsdk.so is not installed; install libirimager from evocortex.org, "
            "or read raw counts with: optris:/dev/video0"
        )
    try:
        library = CDLL(path)
        pointers = {name: kind((f"evo_irimager_{name}", library)) for name, kind in PROTOTYPES.items()}
    except (OSError, AttributeError) as error:
        raise DeviceNotFoundError(
            f"{path} cannot be used ({error}); install libirimager 2 or newer"
        ) from error
    return DirectLibrary(**pointers)

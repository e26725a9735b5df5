"""Recordings of an Azure Kinect, played by Microsoft's SDK."""

from ctypes import CDLL, byref, c_char_p, c_void_p
from ctypes.util import find_library
from pathlib import Path

from sensors.drivers.k4a import SUCCEEDED, Capture, bundled, load_k4a, read_capture, read_text
from sensors.errors import DeviceError


class Playback:
    """A recording (.mkv) that the SDK plays, with the interface of ``Camera``. Raises DeviceError."""

    serial = "recording"

    def __init__(self, path: Path) -> None:
        self._k4a, self._handle = load_k4a(), c_void_p()
        self._record = CDLL(str(bundled("libk4arecord-*") or find_library("k4arecord")))
        if self._record.k4a_playback_open(c_char_p(bytes(path)), byref(self._handle)):
            raise DeviceError(f"{path} cannot be played")

    def start(self) -> None:
        """Do nothing: the recording plays from opening on."""

    def factory_calibration(self) -> bytes:
        """Return the factory's JSON from the recording."""
        return read_text(lambda *buffer: self._record.k4a_playback_get_raw_calibration(self._handle, *buffer))

    def capture(self, timeout_ms: int) -> Capture | None:
        """Return the next capture, or None at the end."""
        capture = c_void_p()
        done = self._record.k4a_playback_get_next_capture(self._handle, byref(capture))
        return read_capture(self._k4a, capture) if done == SUCCEEDED else None

    def close(self) -> None:
        """Close the recording."""
        self._record.k4a_playback_close(self._handle)

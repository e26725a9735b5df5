"""A serial line to one device: requests, and replies of a length that is known beforehand."""

import termios
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import serial

from sensors.device.node import node_error
from sensors.errors import DeviceError, DeviceFaultError, DeviceLostError

REPLY_S = 0.2
"""Seconds to wait for a reply; devices take milliseconds, a USB adapter's timer 16. Chosen by eye."""
QUIET_S = 0.02
"""Seconds of silence after which nothing is left of an earlier reply. Chosen by eye."""
CHATTER_READS = 10
"""Full reads without silence after which the device counts as sending by itself. Chosen by eye."""
GONE = (OSError, termios.error, TypeError, ValueError)
"""What pyserial raises on a port that has vanished, or (the last two) that another thread has closed."""


class SilenceError(DeviceFaultError):
    """Not one byte came in answer."""


class ChatterError(DeviceFaultError):
    """The device sends without a request."""


class SerialLine:
    """Requests and replies of fixed length on a line without framing. Any thread may ``close`` it.

    rs485: the device's address on a bus, 1 to 32, which goes before every command.
    """

    def __init__(self, port: Path, baud: int, rs485: int | None) -> None:
        self.port = port
        self._prefix = b"" if rs485 is None else bytes([0xB0 + rs485])
        try:
            self._serial = serial.Serial(str(port), baud, timeout=0, write_timeout=REPLY_S, exclusive=True)
        except serial.SerialException as error:
            raise node_error(port, error.errno) from error
        except ValueError as error:
            raise DeviceError(f"baud rate {baud} is impossible ({error}); give 9600 to 115200") from error
        # An earlier program may have left a reply on the line.
        self._disturbed = True

    def ask(self, command: bytes, length: int) -> bytes:
        """The reply of exactly ``length`` bytes.

        Raises DeviceFaultError where fewer came, DeviceLostError where the line is gone.
        """
        self.send(command)
        reply = self.receive(length, REPLY_S)
        if len(reply) < length:
            self._disturbed = True
            raise (DeviceFaultError if reply else SilenceError)(
                f"{self.port} answered {len(reply)} of {length} bytes to command {command.hex()}; "
                "check cable, baud rate and family"
            )
        return reply

    def send(self, command: bytes) -> None:
        """Send a command, after what is left of earlier replies was thrown away.

        Raises ChatterError where that does not end.
        """
        if self._disturbed:
            self._fall_silent()
            self._disturbed = False
        self.write(command)

    def write(self, command: bytes) -> None:
        """Send a command at once, even to a device that does not stop sending."""
        with self._connected():
            self._serial.reset_input_buffer()
            self._serial.write(self._prefix + command)

    def receive(self, most: int, timeout_s: float) -> bytes:
        """Up to ``most`` bytes, as many as come within ``timeout_s`` seconds."""
        with self._connected():
            self._serial.timeout = timeout_s
            return bytes(self._serial.read(most))

    def close(self) -> None:
        """Give the port back; a ``receive`` under way ends."""
        if self._serial.is_open:
            self._serial.cancel_read()
        self._serial.close()

    def _fall_silent(self) -> None:
        for _ in range(CHATTER_READS):
            if not self.receive(4096, QUIET_S):
                return
        raise ChatterError(f"{self.port} does not stop sending; switch the device off and on")

    @contextmanager
    def _connected(self) -> Iterator[None]:
        try:
            yield
        except GONE as error:
            raise DeviceLostError(f"{self.port} is no longer connected; plug it in again") from error

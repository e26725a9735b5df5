"""Serial line to one device: requests and replies of known length. Constants are untuned."""

import termios
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import serial

from sensors.device.node import node_error
from sensors.errors import DeviceError, DeviceFaultError, DeviceLostError

REPLY_S = 0.5  # s to wait for a reply; a USB adapter's timer takes 0.016, a loaded computer longer
QUIET_S = 0.02  # s of silence after which an earlier reply has ended
CHATTER_READS = 10  # full reads without silence after which the device counts as sending by itself
GONE = (
    OSError,
    termios.error,
    TypeError,
    ValueError,
)  # pyserial's, on a vanished port or (last two) a closed one


class SilenceError(DeviceFaultError):
    """Error of a missing reply."""


class ChatterError(DeviceFaultError):
    """Error of a device that sends without a request."""


class SerialLine:
    """Serial line without framing; any thread may ``close`` it. rs485: bus address, 1 to 32, sent before each
    command.
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

    def request(self, command: bytes, length: int) -> bytes:
        """Send a command and return the reply of ``length`` bytes.

        Raises DeviceFaultError for a shorter reply, DeviceLostError once the device is gone.
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
        """Discard the rest of earlier replies and send a command. Raises ChatterError if they do not end."""
        if self._disturbed:
            self._fall_silent()
            self._disturbed = False
        self.write(command)

    def write(self, command: bytes) -> None:
        """Send a command at once, even if the device is sending."""
        with self._connected():
            self._serial.reset_input_buffer()
            self._serial.write(self._prefix + command)

    def receive(self, most: int, timeout_s: float) -> bytes:
        """Return at most ``most`` bytes, received within ``timeout_s`` seconds."""
        with self._connected():
            self._serial.timeout = timeout_s
            return bytes(self._serial.read(most))

    def close(self) -> None:
        """Release the port; a ``receive`` under way ends."""
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

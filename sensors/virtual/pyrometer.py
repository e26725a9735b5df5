"""Twin of an Optris pyrometer: its protocol on a pseudo-terminal."""

import os
import select
import threading
import time
import tty
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from math import sin
from pathlib import Path

import numpy as np

from sensors.drivers.pyrometer import PyrometerOptions
from sensors.drivers.pyrometer_protocol import BURST_LAYOUT, BURST_SWITCH, CS_PROCESSOR, SYNC, checksum
from sensors.errors import DeviceError

SERIAL = 8_031_234
BURST_PERIOD_S = 0.01
AMBIENT_C, HEAD_C, BOX_C, PROCESSOR_C = 22.0, 27.4, 31.2, 33.5


@dataclass(frozen=True)
class LineFaults:
    """Faults of the serial line.

    delay_s: before every reply. noise, loss: shares of reply bytes that are changed or lost. refuse: share of
    SET commands with a corrupted checksum.
    """

    delay_s: float = 0.0
    noise: float = 0.0
    loss: float = 0.0
    refuse: float = 0.0


def skin_temperature_c(seconds: float) -> float:
    """Return the temperature of skin that varies slowly between 32.5 and 33.5 C."""
    return 33.0 + 0.5 * sin(0.3 * seconds)


class VirtualPyrometer:
    """Pyrometer that answers on the pseudo-terminal ``port`` until ``unplug``.

    seed: of the random faults. options: of the device itself. target_c: true temperature as a function of the
    seconds since the start. The emissivity scales the difference to the ambient temperature.
    """

    def __init__(
        self,
        options: PyrometerOptions | None = None,
        faults: LineFaults | None = None,
        target_c: Callable[[float], float] = skin_temperature_c,
        seed: int = 0,
    ) -> None:
        options = options or PyrometerOptions()
        self.family, self.emissivity = options.family, 0.97
        self._rs485, self._scale, self._target_c = options.rs485, options.scale, target_c
        self.faults, self._rng = faults or LineFaults(), np.random.default_rng(seed)
        self._layout: tuple[int, ...] = ()
        self._streaming = False
        self._started = time.monotonic()
        try:
            self._master, self._slave = os.openpty()
        except OSError as error:
            raise DeviceError(
                f"this system has no pseudo-terminal ({error.strerror}), which a virtual pyrometer needs; "
                "mount devpts on /dev/pts"
            ) from error
        tty.setraw(self._slave)
        self.port = Path(os.ttyname(self._slave))
        self._wake_read, self._wake_write = os.pipe()
        self._thread = threading.Thread(target=self._serve, name=f"twin {self.port}", daemon=True)
        self._thread.start()

    def unplug(self) -> None:
        """Close the pseudo-terminal, as if the device was unplugged; idempotent."""
        if self._thread.is_alive():
            with suppress(OSError):
                os.write(self._wake_write, b"x")
            self._thread.join()

    def _serve(self) -> None:
        waiting = bytearray()
        try:
            while True:
                pause = BURST_PERIOD_S if self._streaming else None
                ready, _, _ = select.select([self._master, self._wake_read], [], [], pause)
                if self._wake_read in ready:
                    return
                if self._master in ready:
                    waiting += os.read(self._master, 256)
                    while (used := self._execute(waiting)) > 0:
                        del waiting[:used]
                if self._streaming:
                    self._send(SYNC + b"".join(self._item(item) for item in self._layout))
        except OSError:
            return
        finally:
            for fd in (self._master, self._slave, self._wake_read, self._wake_write):
                os.close(fd)

    def _execute(self, waiting: bytearray) -> int:
        """Execute the first command and return its number of bytes, 0 while it is incomplete."""
        start = 1 if waiting and 0xB0 <= waiting[0] < 0xD0 else 0
        if len(waiting) <= start:
            return 0
        code, family = waiting[start], self.family
        lengths = {BURST_LAYOUT: 4, BURST_SWITCH: 1} if family.burst else {}
        data = 2 if code == family.set_emissivity else lengths.get(code, 0)
        guarded = code >= 0x82 and family.checksum
        length = start + 1 + data + guarded
        if len(waiting) < length:
            return 0
        mine = self._rs485 is None or (start == 1 and waiting[0] == 0xB0 + self._rs485)
        command = bytes(waiting[start : start + 1 + data])
        intact = not guarded or waiting[length - 1] == checksum(command)
        if data and code >= 0x82 and self._rng.random() < self.faults.refuse:
            intact = False
        if mine and intact:
            self._send(self._answer(command))
        return length

    def _answer(self, command: bytes) -> bytes:
        code, data, family = command[0], command[1:], self.family
        items = {family.target: 1, family.current_target: 1, family.head: 2, family.box: 3}
        if code == family.set_emissivity:
            self.emissivity = int.from_bytes(data) / 1000
            return data
        if code == BURST_LAYOUT and family.burst:
            nibbles = [n for byte in data for n in (byte >> 4, byte & 15)]
            self._layout = tuple(nibbles[: (*nibbles, 0).index(0)])
        elif code == BURST_SWITCH and family.burst:
            self._streaming = data == b"\x01"
        elif code in items:
            return self._item(items[code])
        elif code == family.emissivity:
            return round(self.emissivity * 1000).to_bytes(2)
        elif code == family.serial:
            return SERIAL.to_bytes(3)
        elif code == CS_PROCESSOR and not family.burst:
            return self._scale.encode(PROCESSOR_C)
        return b""

    def _item(self, item: int) -> bytes:
        """Return the two bytes of a burst item: 1 process, 2 head, 3 box."""
        if item > 1:
            return self._scale.encode(HEAD_C if item == 2 else BOX_C)
        true_c = self._target_c(time.monotonic() - self._started)
        return self._scale.encode(AMBIENT_C + (true_c - AMBIENT_C) * 0.97 / self.emissivity)

    def _send(self, reply: bytes) -> None:
        if not reply:
            return
        if self.faults.delay_s:
            time.sleep(self.faults.delay_s)
        chance = self._rng.random((2, len(reply)))
        noisy = bytes(
            byte ^ int(self._rng.integers(1, 256)) if hit < self.faults.noise else byte
            for byte, hit, lost in zip(reply, *chance, strict=True)
            if lost >= self.faults.loss
        )
        os.write(self._master, noisy)

"""Readings of several devices: a thread and a bounded queue each; lost devices are reopened.

Constants are untuned.
"""

import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import suppress
from queue import Full, Queue

from sensors.device.protocol import Device, DeviceReading
from sensors.errors import DeviceError, DeviceFaultError, one_line
from sensors.recording.arrival_times import Arrivals, Arrived, Event

# Readings, or seconds if more, that may wait for a disk that stalls for a second.
BACKLOG, BACKLOG_S = 64, 2.0
READ_S = 0.2  # s; longest wait before a thread checks for the end
REOPEN_S = 1.0  # s between two attempts to reopen a lost device


class Intake:
    """Readings of started devices; a context manager that reads, and closes the devices at the end.

    reopen: function that opens and starts a lost device. faults: latest protocol violation by address. Raises
    DeviceError if two devices have one stream, or depth is missing.
    """

    def __init__(self, devices: Sequence[Device], reopen: Callable[[str], Device]) -> None:
        _check_streams(devices)
        self._devices = {device.address: device for device in devices}
        self._queues = {
            device.address: Queue[DeviceReading | Exception](
                max(BACKLOG, round(BACKLOG_S * sum(device.rates_hz.values())))
            )
            for device in devices
        }
        self._reopen = reopen
        self._overrun = Counter[str]()
        self._woken, self._stop = threading.Event(), threading.Event()
        self._threads: list[threading.Thread] = []
        self._unix_from_monotonic = time.time_ns() - time.monotonic_ns()
        self._arrivals = Arrivals(self._unix_from_monotonic)
        self.faults: dict[str, Event] = {}

    def __enter__(self) -> "Intake":
        self._threads = [
            threading.Thread(target=self._read, args=(address,), name=f"read {address}", daemon=True)
            for address in self._devices
        ]
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(5)
        for device in self._devices.values():
            device.close()

    @property
    def away(self) -> frozenset[str]:
        """Return the addresses of lost devices."""
        return frozenset(self._arrivals.away)

    def now_ns(self) -> int:
        """Return the host's time since 1970; changes of that clock since the start have no effect."""
        return time.monotonic_ns() + self._unix_from_monotonic

    def wait(self, timeout_s: float) -> None:
        """Wait until a reading or an event may have come."""
        self._woken.wait(timeout_s)
        self._woken.clear()

    def wake(self) -> None:
        """End a ``wait``."""
        self._woken.set()

    def drain(self) -> list[Arrived | Event]:
        """Return all readings and events that had come before the call.

        Later ones wait, because the queues of fast devices may never be empty.
        """
        drained: list[Arrived | Event] = []
        for address, queue in self._queues.items():
            for _ in range(queue.qsize()):
                item = queue.get_nowait()
                if isinstance(item, DeviceReading):
                    drained += self._arrivals.add(address, item, self._overrun.pop(address, 0))
                else:
                    drained.append(self._failed(address, item))
        return drained

    def _failed(self, address: str, error: Exception) -> Event:
        text = str(error)
        if not isinstance(error, DeviceError):
            why = text or "no reason is given"
            text = one_line(
                f"{address} has failed ({why}); wait until it is opened again, or plug it in again"
            )
        happened = Event(self.now_ns(), text)
        if isinstance(error, DeviceFaultError):
            self.faults[address] = happened
        else:
            self._arrivals.away.add(address)
        return happened

    def _read(self, address: str) -> None:
        """Read one device until the end; runs in the device's thread."""
        while not self._stop.is_set():
            try:
                item: DeviceReading | Exception | None = self._devices[address].read(READ_S)
            except Exception as error:  # a maker's library may raise anything; the device is reopened
                item = error
            if item is None:
                continue
            self._enqueue(address, item)
            gone = isinstance(item, Exception) and not isinstance(item, DeviceFaultError)
            if gone and not self._opened_again(address):
                return

    def _enqueue(self, address: str, item: DeviceReading | Exception) -> None:
        is_error = isinstance(item, Exception)
        while True:
            try:
                self._queues[address].put(item, is_error, READ_S)
            except Full:
                # An error is never dropped, because it can mean that a device is gone.
                if is_error and not self._stop.is_set():
                    continue
                self._overrun[address] += 1
            break
        self._woken.set()

    def _opened_again(self, address: str) -> bool:
        """Reopen a lost device as soon as it is connected again; return False if the intake ends before."""
        # A maker's library may raise anything for a camera that is gone.
        with suppress(Exception):
            self._devices[address].close()
        while not self._stop.wait(REOPEN_S):
            with suppress(Exception):
                device = self._reopen(address)
                if self._stop.is_set():
                    device.close()
                    return False
                self._devices[address] = device
                return True
        return False


def _check_streams(devices: Sequence[Device]) -> None:
    streams: dict[str, str] = {}
    for device in devices:
        for stream in device.rates_hz:
            if stream in streams:
                raise DeviceError(
                    f"{streams[stream]} and {device.address} both give {stream}; use one of them"
                )
            streams[stream] = device.address
    if "depth" not in streams:
        raise DeviceError("no device of the rig gives depth; name a depth camera too")

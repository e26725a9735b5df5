"""Which of several plugged-in devices of one kind is meant."""

from collections import Counter

from sensors.errors import DeviceError, DeviceNotFoundError


def choose(kind: str, serials: list[str], wanted: str) -> str:
    """The serial number to open: ``wanted``, or where that is empty the only one there is.

    Raises DeviceNotFoundError where it is not there, DeviceError where several would do.
    """
    if not serials:
        raise DeviceNotFoundError(f"no {kind} is plugged in; see: annotate-cloud devices")
    if not wanted and len(set(serials)) > 1:
        raise DeviceError(f"there are {len(serials)} {kind} devices ({_listed(serials)}); name one by serial")
    serial = wanted or serials[0]
    if serial not in serials:
        raise DeviceNotFoundError(f"no {kind} has serial {serial!r}; plugged in: {_listed(serials)}")
    if Counter(serials)[serial] > 1:
        raise DeviceError(f"two {kind} devices have serial {serial!r}; unplug one of them")
    return serial


def _listed(serials: list[str]) -> str:
    return ", ".join(sorted(set(serials)))

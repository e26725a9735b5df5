"""Device addresses: ``[virtual:]KIND[:TARGET][?KEY=VALUE&...]``."""

from collections.abc import Mapping
from typing import NamedTuple, TypeVar
from urllib.parse import parse_qsl

from sensors.errors import DeviceError

T = TypeVar("T")


class Address:
    """Parsed address with its options.

    ``finish`` refuses options that the driver did not query. Raises DeviceError for malformed or repeated
    options.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        path, _, query = text.partition("?")
        self.virtual = path.startswith("virtual:")
        self.kind, _, self.target = path.removeprefix("virtual:").partition(":")
        try:
            pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=bool(query), max_num_fields=20)
        except ValueError as error:
            raise DeviceError(f"device {text!r} has malformed options; give KIND:TARGET?KEY=VALUE") from error
        self._options, self._known = dict(pairs), set[str]()
        if len(self._options) < len(pairs):
            raise DeviceError(f"device {text!r} gives an option twice; give each once")

    def choice(self, key: str, table: Mapping[str, T], default: str) -> T:
        """Return the entry of ``table`` under the value of option ``key``. Raises DeviceError for an unknown
        value.
        """
        name = self._take(key, default)
        if name not in table:
            raise DeviceError(f"{key} {name!r} of device {self.text!r} is unknown; use {', '.join(table)}")
        return table[name]

    def number(self, key: str, default: float, low: float, high: float) -> float:
        """Return option ``key`` as a number from ``low`` to ``high``. Raises DeviceError for any other
        value.
        """
        value = self.given_number(key, low, high)
        return default if value is None else value

    def given_number(self, key: str, low: float, high: float) -> float | None:
        """Return option ``key`` as ``number`` does, or None if it is absent."""
        text = self._take(key, "")
        if not text:
            return None
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not low <= value <= high:
            raise DeviceError(
                f"{key} {text!r} of {self.text!r} is impossible; give a number from {low:g} to {high:g}"
            )
        return value

    def given_integer(self, key: str, low: int, high: int) -> int | None:
        """Return option ``key`` as an integer from ``low`` to ``high``, or None if it is absent. Raises
        DeviceError for any other value.
        """
        value = self.given_number(key, low, high)
        if value is not None and value != int(value):
            raise DeviceError(
                f"{key} {value:g} of {self.text!r} is not a whole number; give one from {low} to {high}"
            )
        return None if value is None else int(value)

    def finish(self) -> None:
        """Raise DeviceError for an option that was not queried."""
        if unknown := sorted(set(self._options) - self._known):
            remedy = f"use {', '.join(sorted(self._known))}" if self._known else "leave it out"
            raise DeviceError(f"device {self.text!r} has unknown option {unknown[0]!r}; {remedy}")

    def _take(self, key: str, default: str) -> str:
        self._known.add(key)
        return self._options.get(key, default)


class Kind(NamedTuple):
    """Kind of device. needs: required extra or library, or "". tested: substitute for the hardware in the
    tests.
    """

    needs: str
    tested: str


KINDS = {
    "kinect2": Kind("libfreenect2", "a library with its interface"),
    "realsense": Kind("extra `realsense`", "the maker's SDK on its software device, and its recordings"),
    "azure": Kind("extra `kinect` (x86-64)", "the maker's SDK playing a real recording"),
    "orbbec": Kind("extra `orbbec`", "the maker's SDK playing a recording made by the tests"),
    "optris": Kind("nothing", "an imitated kernel"),
    "optris-direct": Kind("the vendor's libirimager", "a library with its interface"),
    "lepton": Kind("nothing", "frames built from the datasheet"),
    "boson": Kind("nothing", "an imitated kernel"),
    "y16": Kind("nothing", "an imitated kernel"),
    "pyrometer": Kind("nothing", "a pseudo-terminal"),
}  # as in the table of docs/devices.md; no driver has been run on hardware

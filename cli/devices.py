"""The verb ``devices``: what can be recorded from."""

from dataclasses import asdict

from cli.console import Json, finish, table


def devices(json: Json = False) -> None:
    """List the devices that are plugged in, and the virtual ones."""
    from sensors.recording.open_device import find_devices

    found = find_devices()
    title = "no device is plugged in; virtual devices:" if all(one.virtual for one in found) else ""
    rows = [(one.address, one.serial, one.note) for one in found]
    text = table(("address", "serial", "note"), rows, title)
    finish({"devices": [asdict(one) for one in found]}, json, text)

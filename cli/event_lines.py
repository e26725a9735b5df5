"""The events of a recording as lines for people."""

import re
from collections import Counter
from collections.abc import Mapping

DROPPED = re.compile(r"(?P<stream>\w+): (?P<lost>\d+) dropped(?:, (?P<slow>\d+) as writing was too slow)?")
"""Text of an event of ``sensors.recording.arrival_times``: images of a stream that are lost."""


def event_lines(events: Mapping[str, int]) -> list[str]:
    """Return a line for each text, and a single one for all images that a stream lost.

    events: how often each text was noted.
    """
    lines, gaps, lost, slow = list[str](), Counter[str](), Counter[str](), Counter[str]()
    for text, times in events.items():
        found = DROPPED.fullmatch(text)
        if found is None:
            lines.append(text + (f" ({times} times)" if times > 1 else ""))
            continue
        stream = found["stream"]
        gaps[stream] += times
        lost[stream] += times * int(found["lost"])
        slow[stream] += times * int(found["slow"] or 0)
    for stream, times in gaps.items():
        places = f" in {times:,} gaps" if times > 1 else ""
        why = f", {slow[stream]:,} as writing was too slow" if slow[stream] else ""
        lines.append(f"{stream}: {lost[stream]:,} dropped{places}{why}")
    return lines

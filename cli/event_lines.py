"""Events of a recording as lines of text."""

import re
from collections import Counter
from collections.abc import Mapping

# As in ``sensors.recording.arrival_times``.
DROPPED = re.compile(r"(?P<stream>\w+): (?P<lost>\d+) dropped(?:, (?P<slow>\d+) as writing was too slow)?")


def event_lines(events: Mapping[str, int]) -> list[str]:
    """Return a line for each text, and one line for all lost images of a stream.

    events: number of each text.
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

"""Export of a label set to an MCAP file for Foxglove: clouds, images, skeletons and events."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mcap_protobuf.writer import Writer

from annotate.foxglove.topics import Shown, shown_messages
from annotate.frame_labels import FrameLabels
from annotate.labelset.label_set import LabelSet
from annotate.labelset.source_recording import Recorded
from sensors.errors import ExistsError, FormatError
from sensors.files.atomic import check_free, replacing
from sensors.rig.frame import FRAME_PERIOD_NS
from sensors.session.messages import METADATA

Joints = Callable[[FrameLabels], Mapping[str, Sequence[float]] | None]  # (x, y, z) mm by joint, depth camera


@dataclass(frozen=True)
class FoxgloveSource:
    """Label set to export. session: recording for colours, temperatures, poses, events and stamps; None =
    depth alone, 30 frames a second.
    """

    labels: LabelSet
    session: Path | None
    joints: Joints


def export_foxglove(
    source: FoxgloveSource, out: Path, advance: Callable[[int], None], *, overwrite: bool = False
) -> list[str]:
    """Write all frames to ``out`` atomically; return remarks on missing data.

    Raises FormatError for an empty or corrupt label set or another set's recording, ExistsError.
    """
    labels, session = source.labels, source.session
    if out.is_dir() or (session is not None and out.exists() and out.samefile(session)):
        raise ExistsError(f"{out} is {'a folder' if out.is_dir() else 'the recording'}; name another file")
    check_free(out, overwrite)
    if not len(labels):
        raise FormatError(f"{labels.path} holds no frames; label some first")
    remarks: dict[str, None] = {}
    out.parent.mkdir(parents=True, exist_ok=True)
    with replacing(out, overwrite) as temporary, temporary.open("wb") as file, Writer(file) as writer:
        writer.add_metadata(METADATA, {"name": labels.source or labels.path.name})
        for shown in _frames(labels, Recorded(labels, session), source.joints, remarks):
            for topic, stamp_ns, message in shown_messages(shown):
                writer.write_message(topic, message, stamp_ns, stamp_ns)
            advance(1)
    return list(remarks)


def _frames(
    labels: LabelSet, recorded: Recorded, joints: Joints, remarks: dict[str, None]
) -> Iterator[Shown]:
    """Yield all frames by id; an event is sent with the first frame at or after its time."""
    events = list(recorded.events)
    last = labels.frame_ids[-1]
    for number, frame in enumerate(labels):
        fused = recorded.fused(frame)
        if fused.remark:
            remarks[fused.remark] = None
        stamp_ns = number * FRAME_PERIOD_NS if fused.frame is None else fused.frame.stamp_ns
        due = len(events) if frame.frame_id == last else sum(stamp <= stamp_ns for stamp, _ in events)
        happened, events = events[:due], events[due:]
        yield Shown(
            stamp_ns,
            fused.cloud,
            frame.parts,
            recorded.calibration,
            fused.frame.color_encoded if fused.frame else None,
            fused.frame.thermal_c if fused.frame else None,
            joints(frame),
            tuple(happened),
            frame.scheme,
        )

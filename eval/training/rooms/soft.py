"""Soft things of random rooms: cushions, and cloth over what lies beneath. Constants are untuned.

Blankets, quilts and clothes on furniture and floors have the rounded, limb-sized shapes of people.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from annotate.array_types import Float64
from synth.surface.furniture import Surface
from synth.surface.rasterize import Mesh, grid_faces, tagged

NODES = 26  # of a cloth, along each side
HALF_M, RADIUS_M, HIGH_M = (0.15, 0.7), (0.05, 0.35), (0.03, 0.35)  # cloth; radii and heights of its bumps
MOST_BUMPS, SHARPNESS = 7, 4  # bumps of a cloth; power of their soft maximum
FOLDS_M, EDGE = (0.0, 0.015), 0.25  # height of its folds; share of its half side in which it falls to 0
HANGING = 0.2  # share of cloths on seats that hang over the back


def blob(rng: np.random.Generator, least_m: float, most_m: float, at_m: Float64) -> Mesh:
    """Return an ellipsoid at a random angle about a place (3,). least_m, most_m: range of its radii."""
    polar, turn = np.meshgrid(np.linspace(0, np.pi, 10), np.linspace(0, 2 * np.pi, 16), indexing="ij")
    ball = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), np.cos(polar)], -1)
    axes = np.exp(rng.uniform(np.log(least_m), np.log(most_m), 3))
    mesh = tagged((ball.reshape(-1, 3) * axes).astype(np.float32), grid_faces(10, 16), Surface.TABLE)
    return mesh.placed(Rotation.random(rng=rng).as_matrix(), at_m)


def cloth(rng: np.random.Generator, at_m: Float64) -> Mesh:
    """Return a cloth over bumps, turned about the vertical, its middle on a surface at a place (3,)."""
    half = _log_uniform(rng, HALF_M, 2)
    side = np.linspace(-1, 1, NODES)
    places = np.stack(np.meshgrid(side, side, indexing="ij"), -1)
    x, y = np.moveaxis(places * half, -1, 0)
    high = np.zeros_like(x)
    for _ in range(int(rng.integers(1, MOST_BUMPS + 1))):
        turn, (a, b) = rng.uniform(0, np.pi), _log_uniform(rng, RADIUS_M, 2)
        cx, cy = rng.uniform(-0.8, 0.8, 2) * half
        along = (x - cx) * np.cos(turn) + (y - cy) * np.sin(turn)
        across = (y - cy) * np.cos(turn) - (x - cx) * np.sin(turn)
        bump = float(_log_uniform(rng, HIGH_M, 1)[0]) * np.exp(-((along / a) ** 2 + (across / b) ** 2) / 2)
        high += bump**SHARPNESS
    high = high ** (1 / SHARPNESS)
    waves = rng.uniform(5, 40, 2)
    high += rng.uniform(*FOLDS_M) * np.sin(waves[0] * x + waves[1] * y)
    fall = np.clip((1 - np.hypot(*np.moveaxis(places**2, -1, 0))) / EDGE, 0, 1)
    nodes = np.stack([x, y, np.maximum(high, 0.01) * fall], -1).reshape(-1, 3).astype(np.float32)
    turn_about = Rotation.from_euler("z", rng.uniform(-np.pi, np.pi)).as_matrix()
    return tagged(nodes, grid_faces(NODES, NODES), Surface.TABLE).placed(turn_about, at_m)


def _log_uniform(rng: np.random.Generator, ends: tuple[float, float], count: int) -> Float64:
    return np.asarray(np.exp(rng.uniform(np.log(ends[0]), np.log(ends[1]), count)))


def laid(rng: np.random.Generator, at_m: Float64, most_m: float = 0.3, above_m: float = 0.1) -> Mesh:
    """Return a cloth at a place (3,), or an ellipsoid up to ``above_m`` over it, radii up to ``most_m``."""
    if rng.random() < 0.5:
        return cloth(rng, at_m)
    return blob(rng, 0.06, most_m, at_m + np.array([0, 0, rng.uniform(0, above_m)]))


def hung(rng: np.random.Generator, at_m: Float64) -> Mesh:
    """Return a cloth that hangs in the plane y = 0 about a place (3,), its bumps towards -y."""
    upright = Rotation.from_euler("x", np.pi / 2 + rng.normal(0, 0.15)).as_matrix()
    return cloth(rng, np.zeros(3)).placed(upright, at_m)

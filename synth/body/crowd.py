"""Sets of shipped adults of both sexes, all ages and builds on one mesh; ``body.blend`` mixes any two."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annotate.array_types import Bool, Float32
from sensors.files.npz import load_arrays
from synth.body.body import MAX_BYTES, Body, shipped_bodies
from synth.data_files import JUDGE, Cast, shipped

STEP_M = 1e-4  # m; stored vertices are quantised to 0.1 mm, far below a depth camera's resolution
REMEDY = "install again"
BASE_VERTICES = 19_158  # of MakeHuman's base mesh hm08, helpers included


EVERY = 40  # every 40th skin vertex takes part in the fit of a mixture of bodies; untuned


@cache
def crowd() -> tuple[Body, ...]:
    """Return 28 adults, women and men in turn, ages 16 to 80, 1.50 to 1.91 m, body mass index 17 to 38.

    Baked from anny by ``python -m tools.fit.crowd``, on the mesh of the paper's bodies.
    """
    like, joints = shipped_bodies()[0], _arrays()["joints_m"]
    own = _vertices_m()[:, : len(like.vertices_m)]
    return tuple(
        replace(like, name=f"crowd_{i:02}", vertices_m=own[i], joints_m=joints[i]) for i in range(len(own))
    )


@cache
def judge_bodies() -> tuple[Body, ...]:
    """Return the 14 bodies of the judging cast: adults, women and men in turn, ages 18 to 85.

    Baked from anny by ``python -m tools.fit.crowd judge``, with other muscles and proportions than the crowd.
    """
    like, arrays = shipped_bodies()[0], load_arrays(shipped("judge", "bodies.npz"), MAX_BYTES, REMEDY)
    whole = np.float32(STEP_M) * (arrays["mean"].astype(np.float32) + arrays["differences"].swapaxes(1, 2))
    return tuple(
        replace(like, name=f"judge_{i:02}", vertices_m=np.ascontiguousarray(own, np.float32), joints_m=joints)
        for i, (own, joints) in enumerate(zip(whole, arrays["joints_m"], strict=True))
    )


def crowd_of(cast: Cast) -> tuple[Body, ...]:
    """Return the bodies of dressed people in images of a cast (set of synthetic people)."""
    return judge_bodies() if cast == JUDGE else crowd()


def suit_wearers(cast: Cast) -> tuple[Body, ...]:
    """Return the bodies of a cast's people in suits or without clothes; in training the paper's eight."""
    return judge_bodies() if cast == JUDGE else shipped_bodies()


def base_mesh_m(body: Body) -> Float32:
    """Return vertices (19158, 3) of MakeHuman's base mesh hm08 around a body at rest, metres, body frame.

    Skin vertices are the body's own. Helper vertices, to which garments are fitted, are mixed from the
    crowd's bodies so that their skin approximates the body's. The mixture is exact for two blended bodies of
    the crowd.
    """
    skin, vertices = _arrays()["skin"], _vertices_m()
    some = vertices[:, : len(skin) : EVERY].reshape(len(vertices), -1).T
    first = some[:, :1]
    asked = body.vertices_m[: len(skin) : EVERY].reshape(-1, 1) - first
    shares = np.linalg.lstsq(some[:, 1:] - first, asked, rcond=1e-4)[0][:, 0]
    helpers = np.einsum("n,nhd->hd", np.append(1 - shares.sum(), shares), vertices[:, len(body.vertices_m) :])
    base = np.empty((BASE_VERTICES, 3), np.float32)
    base[skin], base[_arrays()["helpers"]] = body.vertices_m[: len(skin)], helpers
    return base


def covered_skin(body: Body, hidden: Bool) -> Bool:
    """Return flags (V,) of a body's hidden vertices from flags (19158,) of hm08's hidden vertices.

    A vertex added by cutting faces at part borders is flagged where all its neighbours are.
    """
    skin = _arrays()["skin"]
    flags = np.ones(len(body.vertices_m), np.bool_)
    flags[: len(skin)] = hidden[skin]
    bare = ~flags[body.faces].all(axis=1)
    flags[len(skin) :] = False
    flags[len(skin) :][~np.isin(np.arange(len(skin), len(flags)), body.faces[bare])] = True
    return flags


@cache
def _arrays() -> dict[str, NDArray[Any]]:
    return load_arrays(shipped("crowd.npz"), MAX_BYTES, REMEDY)


@cache
def _vertices_m() -> Float32:
    """Return the vertices (28, V + H, 3) of all bodies at rest, skin first, then helpers."""
    arrays = _arrays()
    whole = arrays["mean"].astype(np.float32) + arrays["differences"].swapaxes(1, 2)
    return np.ascontiguousarray(np.float32(STEP_M) * whole, np.float32)

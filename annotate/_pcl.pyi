import numpy as np
from numpy.typing import NDArray

def supervoxels(
    points_m: NDArray[np.float32],
    colors_rgb: NDArray[np.uint8],
    *,
    voxel_m: float,
    seed_m: float,
    spatial_weight: float,
    normal_weight: float,
    color_weight: float,
) -> tuple[NDArray[np.int32], NDArray[np.int32]]: ...
def euclidean_clusters(
    points_m: NDArray[np.float32], *, tolerance_m: float, min_size: int
) -> NDArray[np.int32]: ...

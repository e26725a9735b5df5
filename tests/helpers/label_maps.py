"""Small labelled frames drawn by hypothesis: camera, ids, and strategies for their images."""

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from annotate.parts import N_CLASSES, UNDEFINED
from sensors.rig.camera import Intrinsics

law = settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
CAMERA = Intrinsics(8, 6, 9.5, 9.25, 3.5, 2.5)
IDS = st.sampled_from([*range(N_CLASSES), UNDEFINED])
depths = arrays(np.uint16, (6, 8))
part_maps = arrays(np.uint8, (6, 8), elements=IDS)
confidences = st.none() | arrays(np.uint8, (6, 8)).map(lambda a: a.astype(np.float32) / np.float32(255))

"""Files of markers, joints and motions: C3D, TRC, BVH, AMASS, arrays."""

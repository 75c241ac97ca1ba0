"""Lines of pose-graph files."""

import numpy as np

UNIT_2D = "1 0 0 1 0 1"
UNIT_3D = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"
COVARIANCE = "0 1 1 2 3 1 0 0 0 1 0 0 0 1\n"
EDGE = f"EDGE_SE2 0 1 1 2 0.5 {UNIT_2D}\n"
WORLD = (
    "VERTEX_SE2 0 0 0 0\n"
    "VERTEX_SE2 1 1 2 0.5\n"
    "VERTEX_SE2 2 3 4 -0.25\n"
    "FIX 0\n"
    "EDGE_SE2 0 1 1 2 0.5 10 1 2 20 3 30\n"
    "EDGE_SE2 1 2 3 4 -0.75 10 1 2 20 3 30\n"
)
# The information of its edges.
MATRIX_2D = np.array([[10.0, 1, 2], [1, 20, 3], [2, 3, 30]])

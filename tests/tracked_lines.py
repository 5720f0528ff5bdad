"""Lines of a measuring machine as a tracker at BASE sees them."""

import numpy as np

BASE = np.array([-0.21, 1.38, -0.3])


def box(corner=0.8, n=9):
    """Points and directions of lines along x, y and z of a machine."""
    run, zero, far = np.linspace(0.0, corner, n), np.zeros(n), np.full(n, corner)
    points = np.vstack([np.column_stack(line) for line in ((run, zero, zero), (far, run, zero), (far, zero, run))])
    return points, np.repeat(np.eye(3), n, axis=0)

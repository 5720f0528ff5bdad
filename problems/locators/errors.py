"""Exact multi-body model of one 3-axis locator: the ball centre from three travels and all 21 geometric errors.

Bodies X, Y and Z ride on each other; every body brings a connection (eq 8, 10, 12), the squareness of its axis
(eq 23, 25, 27), its travel (eq 9, 11, 13) and six errors of motion (eq 24, 26, 28). Source of all equation numbers:
Li Chen, Fang Qiang, Li Jiangxiong 2010, article no. 1001-4551(2010)03-0006-08.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from calib.geometry import Transform, column, matrix

AXES = ("x", "y", "z")
# The names of table 1: delta_i<axis>(<body>) and delta q_i [m], epsilon_i<axis>(<body>) and squareness [rad].
SHIFTS = (*(f"d{axis}_{body}" for body in AXES for axis in AXES), "dq_x", "dq_y", "dq_z")
TURNS = (*(f"e{axis}_{body}" for body in AXES for axis in AXES), "exy", "eyz", "ezx")
BODY_OF = {f"{kind}{axis}_{body}": body for kind in "de" for body in AXES for axis in AXES}


@dataclass(frozen=True)
class Frames:
    """Lever arms of one locator: where its moving bodies and its ball sit.

    x_in_base, y_in_x, z_in_y: (3,) [m], origin of the frame of motion of body X in the base, Y in X, Z in Y, all
    travels zero (p_i(x), p_i(y), p_i(z) of the paper); ball_in_z: (3,) [m], ball centre in body Z (q_i).
    """

    x_in_base: Any
    y_in_x: Any
    z_in_y: Any
    ball_in_z: Any

    @staticmethod
    def of_matrix(rows: Any) -> Frames:
        """Frames from a matrix (4, 3) [m] of the four vectors."""
        return Frames(*(column(rows[i, 0], rows[i, 1], rows[i, 2]) for i in range(4)))

    @staticmethod
    def with_levers(base: Sequence[float], abbe_height: float, reach_at_zero: float) -> Frames:
        """Frames of a locator of which only two lever arms matter.

        base: (3,) [m], ball centre with all travels zero; abbe_height: [m], height of the ball above the guide of X
        with all travels zero; reach_at_zero: [m], distance along y of the ball from the guide of X with all travels
        zero. The squareness levers y and z start at zero: the ball is the reference point of body Z.
        """
        y_in_x, z_in_y = np.array([0.0, reach_at_zero, 0.0]), np.array([0.0, 0.0, abbe_height])
        return Frames(np.asarray(base, dtype=float) - y_in_x - z_in_y, y_in_x, z_in_y, np.zeros(3))

    @property
    def matrix(self) -> np.ndarray:
        """The four vectors as rows (4, 3) [m]."""
        return np.array([np.asarray(getattr(self, field.name), dtype=float) for field in fields(self)])

    @property
    def base(self) -> Any:
        """Ball centre (3,) [m] in the hall with all travels zero."""
        return self.x_in_base + self.y_in_x + self.z_in_y + self.ball_in_z

    @property
    def abbe_height(self) -> Any:
        """Height [m] of the ball above the guide of X with all travels zero: lever of the pitch of X."""
        return self.y_in_x[2] + self.z_in_y[2] + self.ball_in_z[2]

    @property
    def reach(self) -> Any:
        """Distance [m] along y of the ball from the guide of X with all travels zero: lever of roll and yaw of X."""
        return self.y_in_x[1] + self.z_in_y[1] + self.ball_in_z[1]


def small_turn(about_x: Any, about_y: Any, about_z: Any) -> Any:
    """The matrix (3, 3) of three small angles [rad], as eq 22 has it."""
    return matrix([[1.0, -about_z, about_y], [about_z, 1.0, -about_x], [-about_y, about_x, 1.0]])


def ball_centre(travel: Any, error: dict[str, Any], frames: Frames) -> Any:
    """Ball centre (3,) [m] in the hall, eq 14 with the errors of eq 16-28; nothing is dropped but what eq 22 drops.

    travel: (3,) [m] along x, y, z; error: each name of SHIFTS and TURNS with its value [m or rad] at this travel.
    """
    connections = (frames.x_in_base, frames.y_in_x, frames.z_in_y)
    squareness = ((0.0, 0.0, 0.0), (0.0, 0.0, error["exy"]), (error["eyz"], error["ezx"], 0.0))
    hall_from_body = Transform.identity()
    for i, body in enumerate(AXES):
        along = column(*(travel[i] if k == i else 0.0 for k in range(3)))
        moved = column(*(error[f"d{axis}_{body}"] for axis in AXES))
        turned = small_turn(*(error[f"e{axis}_{body}"] for axis in AXES))
        hall_from_body = (hall_from_body @ Transform(np.eye(3), connections[i])           # eq 8, 10, 12
                          @ Transform(small_turn(*squareness[i]), np.zeros(3))            # eq 23, 25, 27
                          @ Transform(np.eye(3), along)                                   # eq 9, 11, 13
                          @ Transform(turned, moved))                                     # eq 24, 26, 28
    return hall_from_body @ (frames.ball_in_z + column(*(error[f"dq_{axis}"] for axis in AXES)))

"""Tables of Denavit and Hartenberg: to a mechanism and back, also for parallel axes."""

import numpy as np
import pytest

from calib.errors import InputError
from calib.geometry import Transform, rotation_from_rpy, rotation_x, rotation_z
from calib.mechanism import Frame, Linear, Mechanism, Rotary, table


def crooked(seed, tilt):
    """Five rotary axes and a linear one, all off their places; tilt: of the third against the second axis [rad]."""
    generator = np.random.default_rng(seed)
    axes, direction, point = [], np.array([0.0, 0.0, 1.0]), np.zeros(3)
    for i in range(6):
        turn = rotation_from_rpy(*generator.normal(0, tilt if i == 2 else 0.8, 3))
        direction = turn @ direction
        point = point + generator.normal(0, 0.3, 3)
        kind = Linear if i == 4 else Rotary
        axes.append(kind(f"J{i + 1}", direction, point, axes[-1].name if axes else None))
    return Mechanism("crooked", axes, [Frame("tip", point + [0, 0.1, 0.2], rotation_from_rpy(0.1, 0.2, 0.3), "J6")])


@pytest.mark.parametrize("there, back", [(table.standard, table.from_standard), (table.modified, table.from_modified)])
@pytest.mark.parametrize("tilt", [0.8, 0.1])
def test_a_table_says_the_same_as_the_mechanism(there, back, tilt):
    mechanism = crooked(1, tilt)
    found = there(mechanism)
    again = back("again", found.rows, found.base, found.tip)
    positions = np.random.default_rng(2).uniform(-1, 1, (10, 6))
    for here, other in zip(mechanism.poses("tip", positions), again.poses("tip", positions), strict=True):
        np.testing.assert_allclose(here, other, atol=1e-12)


@pytest.mark.parametrize("tilt", [0.0, 1e-9, 1e-6, 1e-3])
def test_nearly_parallel_axes_get_the_row_of_hayati_with_small_numbers(tilt):
    mechanism = crooked(3, tilt)
    found = table.standard(mechanism)
    assert found.rows[1].beta is not None and found.rows[1].d == 0.0
    assert max(abs(row.d) + abs(row.a) for row in found.rows) < 50.0
    again = table.from_standard("again", found.rows, found.base, found.tip)
    positions = np.random.default_rng(2).uniform(-1, 1, (10, 6))
    for here, other in zip(mechanism.poses("tip", positions), again.poses("tip", positions), strict=True):
        np.testing.assert_allclose(here, other, atol=1e-11)


def test_a_modified_table_refuses_a_perpendicular_far_away():
    with pytest.raises(InputError, match=r"parallel to .* use `standard`"):
        table.modified(crooked(3, 1e-6))


def test_a_standard_row_moves_as_its_definition_says():
    row = table.Row("J1", theta=0.3, d=0.1, a=0.2, alpha=-0.5)
    rotations, places = table.from_standard("one", [row]).poses("tip", [[0.7]])
    by_hand = Transform(rotation_z(1.0), np.array([0, 0, 0.1])) @ Transform(rotation_x(-0.5), np.array([0.2, 0, 0]))
    by_hand = Transform(rotation_z(1.0), np.zeros(3)) @ Transform(np.eye(3), np.array([0.2, 0, 0.1])) \
        @ Transform(rotation_x(-0.5), np.zeros(3))
    np.testing.assert_allclose(rotations[0], by_hand.rotation, atol=1e-15)
    np.testing.assert_allclose(places[0], by_hand.translation, atol=1e-15)

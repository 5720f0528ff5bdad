"""What axes do wrong with the conditions of a measurement: the direction they came from, and the temperature."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calib.effect import Effect
from calib.mechanism.axis import COMPONENTS, Axis
from calib.mechanism.chain import Mechanism
from calib.mechanism.drive import backlash, thermal_growth, thermal_scale
from calib.units import kelvin_from_celsius

APPROACH = "{}_approach"        # column and covariate: +1 where the axis came from below, -1 from above, 0 unknown


def driven_by_conditions(mechanism: Mechanism) -> tuple[Effect, ...]:
    """Backlash of each axis, expansion of each linear scale, growth of what carries each axis that is itself carried.

    They ask for the covariates `<axis>_approach` and `temperature_difference` [K]; `problem.acting` drops those that a
    measurement has no such column for. Growth: displacements along X, Y, Z of the reference, for rotary axes only
    (where a linear axis begins is its zero).
    """
    def across(axis: Axis) -> tuple[str, ...]:
        return tuple(c for i, c in enumerate(COMPONENTS[:3]) if i != axis.along)
    return (*(backlash(axis, APPROACH.format(axis.name)) for axis in mechanism.axes),
            *(thermal_scale(axis) for axis in mechanism.axes if not axis.is_rotary),
            *(thermal_growth(axis, c) for axis in mechanism.axes if axis.is_rotary and axis.carried_by
              for c in across(axis)))


def drawn_conditions(mechanism: Mechanism, count: int, seed: int) -> dict[str, np.ndarray]:
    """Conditions of a simulated measurement: directions of approach (count,) of every axis, temperatures within 3 K."""
    generator = np.random.default_rng(seed)
    drawn = {APPROACH.format(axis.name): generator.choice([-1.0, 1.0], count) for axis in mechanism.axes}
    return drawn | {"temperature_difference": np.round(generator.uniform(-3.0, 3.0, count), 1)}


def written_conditions(mechanism: Mechanism, covariates: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Columns of a table with the conditions of a simulated measurement: {header: (n,) SI}."""
    names = [APPROACH.format(axis.name) for axis in mechanism.axes]
    return {**{name: covariates[name] for name in names},
            "temp_C": kelvin_from_celsius(20.0 + covariates["temperature_difference"])}


def approaches(mechanism: Mechanism, table: Any) -> dict[str, np.ndarray]:
    """The directions of approach that a table has, {`<axis>_approach`: (n,)}, as covariates."""
    names = [APPROACH.format(axis.name) for axis in mechanism.axes]
    return {name: np.asarray(table.whole(name), float) for name in names if table.has(name)}

"""The base-point paper recomputed from its own tables: every printed number, by the paper's method and jointly.

The paper's method: the start length is tied to the zero point, L0 = |C - A0|, and the coordinates are exact. Joint: the
reading at the zero point is free. The paper states no uncertainty of its readings; u = 1 um is the noise that its own
simulation needs (section 3), and u_vc follows from the scatter.
Source: Chen, Li, Zhang, Zhao, J. Astronautic Metrology and Measurement 27(2), 2007, 9-13 ("the paper").
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calib import (
    Estimate,
    Linearisation,
    Problem,
    covariance,
    linearise,
    montecarlo,
    simulate,
    solve,
    variance_components,
)
from calib.table import shipped
from calib.units import degree, mm, um
from calib.workflow.reproduce import Item, Printed, Reproduction
from problems import base_point, base_point_layout
from problems.base_point import LENGTHENING, SHORTENING, FreeStart, TiedStart, algebraic
from problems.base_point.lines import Lines
from problems.base_point_layout import FREE, KNOWN, TIED

Array = NDArray[np.float64]

U_ASSUMED = 1.0 * um
NOISE_PRINTED, NOISE_NEEDED = 0.1 * um, 1.0 * um
PITCH = 140.0 * mm
POINTS = 10
OFF = 500.0 * mm
FEET = {"sym": 700.0 * mm, "half": 1400.0 * mm}
TRIALS_ASSUMED = 100                  # the paper says "many repetitions" and prints no number
ZERO_POINT = (0.0, 0.0, 0.0)


# --- the experiment of section 4 -----------------------------------------------------------------------------------


def experiment(column: str) -> Lines:
    """Table 2 with the readings of one column: d (after the digit repairs) or d_printed."""
    table = shipped("base_point/table2_experiment.csv")
    points = np.column_stack([table.number(axis, "length") for axis in "xyz"])
    along = np.where((table.text("line") == "X")[:, None], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    return Lines(points, table.number(column, "length"), U_ASSUMED, along, rows=table.whole("i"))


@dataclass(frozen=True)
class Result:
    """One evaluation of table 2."""

    estimate: Estimate
    fit: Linearisation
    rescaled: Linearisation

    @staticmethod
    def of(column: str, zero: base_point.Zero) -> Result:
        """Evaluate a column of table 2."""
        estimate = solve(base_point.declare(experiment(column), zero, sense=SHORTENING))
        fit = linearise(estimate)
        return Result(estimate, fit, variance_components(fit).rescaled(fit))

    @property
    def squares(self) -> float:
        """Residual sum of squares [m^2]."""
        return float(np.sum(self.estimate.residuals["tracker"] ** 2))

    def coordinate(self, axis: int) -> tuple[float, float, float]:
        """Value, u and u_vc of one coordinate of the base point [mm]."""
        u, u_vc = covariance(self.fit, "base_point").u[axis], covariance(self.rescaled, "base_point").u[axis]
        return float(self.estimate["base_point"][axis] / mm), float(u / mm), float(u_vc / mm)


def _experiment_items(printed: dict[str, Printed], tied: Result, free: Result, as_printed: Result) -> list[Item]:
    start, u_start = covariance(free.fit, "start_reading")["start_reading"]
    dof = free.estimate.dof
    ratio = (tied.squares - free.squares) / (free.squares / dof)
    basis = (f"no uncertainty of the readings is printed: u from {U_ASSUMED / um:g} um for each, coordinates exact; "
             "u_vc from the scatter of the residuals. ")
    tie = (f"Joint: with the start reading free it comes out at {start / um:.1f} um (u = {u_start / um:.1f} um at "
           f"{U_ASSUMED / um:g} um) at the zero point, and the sum of squares falls from {tied.squares / mm**2:.3g} to "
           f"{free.squares / mm**2:.3g} mm^2 (F = {ratio:.0f} on 1 and {dof} degrees of freedom): the readings refuse "
           "the tie L0 = |C|")
    why = {
        "base_x": "rows 14 and 25 after the digit repairs",
        "base_y": "printed to one decimal only (1.4009e+003)",
        "base_z": "compared without its sign: " + algebraic.unseen(experiment("d").points)[0],
    }
    items = []
    for axis, key in enumerate(("base_x", "base_y", "base_z")):
        (value, u, u_vc), (joint, joint_u, joint_u_vc) = tied.coordinate(axis), free.coordinate(axis)
        items.append(Item(key, f"base point, coordinate {'xyz'[axis]}", "mm", printed[key], value=value, u=u,
                          u_vc=u_vc, joint=joint, joint_u=joint_u, joint_u_vc=joint_u_vc, magnitude=axis == 2,
                          why=f"{why[key]}; {basis}{tie}", value_as_printed=as_printed.coordinate(axis)[0]))
    n = len(experiment("d"))

    def deviation(result: Result, spare: int) -> float:
        return float(np.sqrt(result.squares / spare) / um)

    items += [
        Item("ssq", "residual sum of squares", "mm^2", printed["ssq"], value=tied.squares / mm**2,
             joint=free.squares / mm**2, value_as_printed=as_printed.squares / mm**2, why=tie),
        Item("s", "standard deviation of a reading", "um", printed["s"], value=deviation(tied, n - 2),
             joint=deviation(free, dof), value_as_printed=deviation(as_printed, n - 2),
             value_with_three_unknowns=deviation(tied, n - 3),
             why=f"the paper divides by 32-2; three unknowns were fitted, so by 29: {deviation(tied, n - 3):.4f} um "
             f"instead of {deviation(tied, n - 2):.4f} um, both print as 1.3"),
        Item("n_points", "number of points", "1", printed["n_points"], value=n),
    ]
    return items


# --- the simulation of section 3 ------------------------------------------------------------------------------------


def travel() -> Array:
    """Nominal positions b_i = i 140 mm [m] of the targets of the simulation."""
    return PITCH * np.arange(1.0, POINTS + 1.0)


def layout_targets() -> Array:
    """The targets (n, 2) [m] of the simulation on their line."""
    return np.column_stack([travel(), np.zeros(POINTS)])


def one_line(foot: float, noise: float) -> Problem:
    """The simulation by equation 1, as a plan: unknown are L0 and cos(theta0)."""
    return base_point.declare_one_line(travel(), None, noise, LENGTHENING, begin=(foot, OFF))


def sigma_x(foot: float, noise: float) -> float:
    """Standard deviation [um] of the coordinate along the line by equation 1, linearised."""
    return float(covariance(linearise(one_line(foot, noise)), "beside").u[0] / um)


def simulated_sigma_x(foot: float, noise: float, trials: int, seed: int) -> float:
    """The same [um] as the standard deviation of re-solved simulated readings."""
    estimate = solve(simulate(one_line(foot, noise), None, seed, noise=False))
    return float(montecarlo(estimate, trials, seed).u[0] / um)


def _simulation_items(printed: dict[str, Printed]) -> list[Item]:
    table = shipped("base_point/table1_symmetric_simulation.csv")
    a, b, e = (table.number(name, "length") for name in ("a", "b", "e"))
    rounding = 0.5e-4 * mm / np.sqrt(3.0)
    found = solve(base_point.declare_one_line(b, a, rounding, LENGTHENING, begin=(0.6, 0.4)))["beside"] / mm
    index, n = np.arange(1, len(b) + 1), len(b)
    pitch, spread = float(index @ b / (index @ index)), float(np.sqrt(np.mean((b - PITCH * index) ** 2)))
    noise = float(np.sqrt(np.mean(e**2)))
    scatter = printed["sim_b_spread"].number or np.nan
    setting = "a setting of the simulation, of which no readings are printed; it enters sigma_x_half and theta_half"
    items = [
        Item("sim_C_sym_x", "base point of the symmetric simulation", "mm", printed["sim_C_sym_x"], value=found[0],
             why="solved from columns a and b of table 1, in which a is free of noise"),
        Item("sim_C_sym_y", "base point of the symmetric simulation", "mm", printed["sim_C_sym_y"], value=found[1],
             why="its distance from the line, solved from table 1"),
        *(Item(key, "base point of the half-symmetric simulation", "mm", printed[key], why=setting)
          for key in ("sim_C_half_x", "sim_C_half_y")),
        Item("sim_n", "number of targets", "1", printed["sim_n"], value=n),
        Item("sim_pitch", "pitch of the targets", "mm", printed["sim_pitch"], value=pitch / mm,
             sampling=1.96 * scatter / np.sqrt(index @ index), why="slope of column b of table 1"),
        Item("sim_b_spread", "scatter of the targets", "mm", printed["sim_b_spread"], value=spread / mm,
             sampling=1.96 * scatter / np.sqrt(2 * n), why="rms of b - i 140 mm in table 1"),
        Item("sim_noise_printed", "standard deviation of the noise", "mm", printed["sim_noise_printed"],
             value=noise / mm, sampling=1.96 * noise / mm / np.sqrt(2 * n),
             why=f"rms of column e of table 1: {noise / um:.2f} um; its sum of squares is "
             f"{np.sum(e**2) / NOISE_PRINTED**2:.0f} on {n} degrees of freedom for a noise of 0.0001 mm, and "
             f"{np.sum(e**2) / NOISE_NEEDED**2:.1f} for 0.001 mm, which both sigma_x need too"),
    ]
    sigma = {name: sigma_x(foot, NOISE_NEEDED) for name, foot in FEET.items()}
    free = {name: base_point_layout.uncertainties(layout_targets(), (foot, OFF), FREE, NOISE_NEEDED) / um
            for name, foot in FEET.items()}
    for name, foot in FEET.items():
        key = f"sigma_x_{name}"
        items.append(Item(
            key, "standard deviation of x", "um", printed[key], value=sigma[name], joint=float(free[name][0]),
            sampling=1.96 * sigma[name] / np.sqrt(2 * (TRIALS_ASSUMED - 1)),
            value_as_printed=sigma_x(foot, NOISE_PRINTED),
            monte_carlo=simulated_sigma_x(foot, NOISE_NEEDED, 1000, 2007),
            why="equation 1 with the unknowns L0 and cos(theta0), b exact, noise 0.001 mm; with the printed 0.0001 mm "
            f"a tenth of it. The sample size is not printed (\"many\"): {TRIALS_ASSUMED} is taken. Joint: start free"))
    items.append(Item(
        "ratio", "sigma_x half-symmetric by symmetric", "1", printed["ratio"], value=sigma["half"] / sigma["sym"],
        joint=float(free["half"][0] / free["sym"][0]),
        why="for x only, and only with the start tied; for y it is below 2 (study `layouts`)"))
    return items


def _layout_items(printed: dict[str, Printed]) -> list[Item]:
    turn = {name: base_point_layout.mirror_rotation(travel(), foot, OFF) / degree for name, foot in FEET.items()}
    best, best_free = (base_point_layout.best_layout(zero, starts=4, seed=1) for zero in (KNOWN, FREE))
    theirs = base_point_layout.root_of_trace(-_directions(0.0, 60.0, -60.0), (0.0, 0.0), FREE)
    return [
        Item("theta_sym", "rotation of the tracking mirror, symmetric", "deg", printed["theta_sym"], value=turn["sym"],
             why=f"the beam turns by {2 * turn['sym']:.1f} deg from the zero to the last target, the mirror by half of "
             f"it; 70 deg is what the beam turns in the half-symmetric layout ({2 * turn['half']:.1f} deg)"),
        Item("theta_half", "rotation of the tracking mirror, half-symmetric", "deg", printed["theta_half"],
             value=turn["half"], why="half of the angle between the beams to the zero and to the last target"),
        Item("min_sqrt_Q", "smallest sqrt(Q11 + Q22) of three targets", "1", printed["min_sqrt_Q"], value=best.value,
             joint=best_free.value, bound=best.bound, printed_layout_with_free_start=theirs,
             why=f"the printed matrix A itself gives 2/sqrt(3) = {best.bound:.4f}, which is the minimum: the "
             "eigenvalues a, b of A'A have a + b = 3, so Q11 + Q22 >= 4/3. Joint: with the start length unknown too, "
             f"three targets at 120 deg around the base point give the same {best_free.value:.4f}, the printed layout "
             f"{theirs:.3f}"),
    ]


def _directions(*angles: float) -> Array:
    """Unit vectors (n, 2) at angles [deg]."""
    return np.column_stack([np.cos(np.radians(angles)), np.sin(np.radians(angles))])


# --- all of it --------------------------------------------------------------------------------------------------------


def reproduce() -> Reproduction:
    """Every printed number of the paper beside what its tables give."""
    printed = Printed.read("base_point/published_values.csv")
    tied, free = Result.of("d", TiedStart(ZERO_POINT)), Result.of("d", FreeStart(ZERO_POINT))
    experimental = _experiment_items(printed, tied, free, Result.of("d_printed", TiedStart(ZERO_POINT)))
    items = {item.key: item for item in (*experimental, *_simulation_items(printed), *_layout_items(printed))}
    return Reproduction(base_point.published, tuple(items[key] for key in printed), studies=_studies(free),
                        figures={"Residuals of table 2: start tied, and free": _residuals(tied, free)})


def _residuals(tied: Result, free: Result) -> Callable[[], Any]:
    """The residuals along both lines, and the printed ones, drawn when asked for."""
    def draw() -> Any:
        from matplotlib.figure import Figure
        table = shipped("base_point/table2_experiment.csv")
        figure = Figure(figsize=(7.5, 3.4), layout="constrained")
        axes = figure.subplots()
        for name, result in (("start tied", tied), ("start free", free)):
            axes.plot(table.whole("i"), result.estimate.residuals["tracker"][:, 0] / um, ".-", label=name)
        axes.plot(table.whole("i"), table.number("delta_um", "length") / um, "kx", label="printed")
        axes.set(xlabel="row (to 14: line X, then line Y)", ylabel="residual [um]")
        axes.legend()
        return figure
    return draw


def _studies(free: Result) -> dict[str, Any]:
    layouts = []
    for name, foot in FEET.items():
        for zero, words in ((TIED, "tied to the zero point"), (FREE, "free"), (KNOWN, "known")):
            u = base_point_layout.uncertainties(layout_targets(), (foot, OFF), zero, NOISE_NEEDED) / um
            layouts.append({"layout": name, "start": words, "u_x_um": float(u[0]), "u_y_um": float(u[1])})
    residuals = free.estimate.residuals["tracker"][:, 0]
    return {"layouts": layouts, "lag_one_correlation_of_joint_residuals": float(
        residuals[1:] @ residuals[:-1] / (residuals @ residuals))}

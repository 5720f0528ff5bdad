"""A 7-axis arm, 1,000 measured poses or points: estimate with covariance and redundancy numbers, beside scipy's
least_squares on the same residuals and, for points, beside figaroh (PyPI) where it is installed.

Run: python benchmarks/mechanism_speed.py. No compiler is needed. scipy sees the same whitened residuals from the same
row functions and forms its Jacobian by differences (its default) or receives ours. figaroh brings its own model on
pinocchio and its own choice of identifiable parameters, and is adjusted as its BaseCalibration does, by least_squares
with differences. Times are CPU seconds of one thread, after import.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time

import numpy as np

import calib
from calib import Gaussian, Observations, Pose, Problem, Unknown
from calib.geometry import Transform, rotation_from_rpy
from calib.mechanism import Frame, Load, Mechanism, Rotary, encoder_harmonic, location_errors, observe, sag, scale
from calib.mechanism.statement import minimal
from calib.solve.estimate import start_values
from calib.system import System
from calib.units import mm, mrad

WORLD = (np.array([2.0, 0.5, 0.3]), np.array([0.1, 0.2, 1.0]))        # place [m], roll, pitch, yaw [rad] of the arm
U_POINT = 0.05 * mm


def arm() -> Mechanism:
    """Seven rotary axes that alternate between turning and bending, as cobots have them."""
    heights, bends, axes = (0.33, 0.0, 0.32, 0.0, 0.38, 0.0, 0.11), ((0, 0, 1), (0, 1, 0)), []
    height = 0.0
    for i, step in enumerate(heights):
        height += step
        axes.append(Rotary(f"J{i + 1}", bends[i % 2], (0.08 if i in (3, 4) else 0.0, 0.0, height), axes[-1].name
                           if axes else None,
                           (-2.9, 2.9)))
    return Mechanism("arm", axes, [Frame("flange", (0.09, 0, height + 0.1), carried_by="J7")],
                     [Load(f"L{i}", np.asarray(axes[i].through) + [0, 0, 0.1], axes[i].name, 3.0 - 0.3 * i)
                      for i in range(7)])


def declared(families: tuple[str, ...], poses: int) -> tuple[Problem, dict[str, object]]:
    """The problem with everything free that these poses can know, and the simulated truth."""
    mechanism, generator = arm(), np.random.default_rng(1)
    effects = list(location_errors(mechanism))
    for family, make in (("encoder", encoder_harmonic), ("scale", scale)):
        effects += [make(axis) for axis in mechanism.axes] if family in families else []
    effects += [sag(mechanism, a) for a in mechanism.axes] if "sag" in families else []
    for order, family in ((2, "second"), (3, "third")):
        effects += [encoder_harmonic(axis, order) for axis in mechanism.axes] if family in families else []
    positions = generator.uniform(-2.0, 2.0, (poses, 7))
    world, target = Transform(rotation_from_rpy(*WORLD[1]), WORLD[0]), Transform(np.eye(3),
                                                                                                      np.zeros(3))
    rotations, _ = mechanism.poses("flange", positions)
    observations = Observations(
        observe.measured_pose(mechanism.pose("flange")), Pose("world", world.rotation, world.translation), positions,
        Pose("target", target.rotation, target.translation), world.rotation @ rotations, readings=None,
        u=Gaussian.standard([0.05 * mm] * 3 + [0.1 * mrad] * 3), group="poses")
    problem = Problem([observations], effects=effects)
    problem = problem.free(*effects)
    problem = problem.hold(*minimal(calib.linearise(problem)).to_hold)
    truth = {problem.parameters(e).name: generator.normal(0, 3e-4, (1, len(e.parameters))) for e in effects}
    free = {n: np.where(problem.is_held(problem.parameters(e)), 0.0, v) for (n, v),
            e in zip(truth.items(), effects, strict=True)}
    return calib.simulate(problem, free, 2), free


def ours(problem: Problem) -> tuple[float, calib.Estimate, float]:
    """CPU time of estimate, covariance and redundancy numbers; the estimate; the sum of the redundancy numbers."""
    begin = time.process_time()
    estimate = calib.solve(problem)
    fit = calib.linearise(estimate)
    calib.covariance(fit)
    redundancy = calib.reliability(fit).redundancy.sum()
    return time.process_time() - begin, estimate, float(redundancy)


def scipys(problem: Problem, analytic: bool) -> tuple[float, float, int]:
    """CPU time of scipy's least_squares from the same start with its covariance; its objective; its evaluations."""
    from scipy.optimize import least_squares
    system = System(problem)
    start = start_values(system, None)
    weightings, free = system.weightings(start), system.layout.free_columns

    def at(x: np.ndarray) -> dict:
        step = np.zeros(system.layout.size)
        step[free] = x
        return system.layout.move(start, step)

    def residual(x: np.ndarray) -> np.ndarray:
        return system.whitened(at(x), weightings)

    def jacobian(x: np.ndarray) -> np.ndarray:
        return -np.concatenate([b.dense(system.layout.position, len(free)) for b in system.blocks(at(x), weightings)])
    begin = time.process_time()
    found = least_squares(residual, np.zeros(len(free)), jac=jacobian if analytic else "2-point", method="lm",
                          xtol=1e-12, ftol=1e-12, gtol=1e-12)
    np.linalg.inv(found.jac.T @ found.jac)
    return time.process_time() - begin, 2 * found.cost, found.nfev


def points(count: int) -> tuple[Problem, np.ndarray]:
    """The geometric errors of the arm from measured points of one target, simulated; the positions (count, 7)."""
    mechanism, generator = arm(), np.random.default_rng(1)
    effects, positions = location_errors(mechanism), generator.uniform(-2.0, 2.0, (count, 7))
    observations = Observations(
        observe.measured_point(mechanism.pose("flange")), Pose("world", rotation_from_rpy(*WORLD[1]), WORLD[0]),
        positions, Unknown("target", [0.05, 0.02, 0.08]), u=U_POINT, group="points")
    problem = Problem([observations], effects=effects).free(*effects)
    problem = problem.hold(*minimal(calib.linearise(problem)).to_hold)
    truth = {problem.parameters(e).name: generator.normal(0, 3e-4, (1, 1)) * ~problem.is_held(problem.parameters(e))
             for e in effects}
    return calib.simulate(problem, truth, 2), positions


def figarohs(problem: Problem, positions: np.ndarray) -> tuple[float, float, int]:
    """CPU time of figaroh's choice of parameters and adjustment; its v'Pv; how many parameters it kept."""
    import pinocchio
    from figaroh.calibration import calibration_tools as figaroh
    from figaroh.calibration.parameter import BASE_TPL, EE_TPL, FULL_PARAMTPL
    from scipy.optimize import least_squares
    mechanism, model, behind = arm(), pinocchio.Model(), np.zeros(3)
    for i, axis in enumerate(mechanism.axes):
        joint = pinocchio.JointModelRZ() if axis.along == 2 else pinocchio.JointModelRY()
        model.addJoint(i, joint, pinocchio.SE3(np.eye(3), axis.through - behind), axis.name)
        behind = np.asarray(axis.through)
    flange = pinocchio.SE3(np.eye(3), mechanism.frame("flange").at - behind)
    model.addFrame(pinocchio.Frame("flange", len(mechanism.axes), 0, flange, pinocchio.FrameType.OP_FRAME))
    model.addFrame(pinocchio.Frame("base", 0, 0, pinocchio.SE3.Identity(), pinocchio.FrameType.OP_FRAME))
    data, ends = model.createData(), [*BASE_TPL, *(f"{name}_1" for name in EE_TPL[:3])]
    names = [*ends, *(f"{name}_{axis.name}" for axis in mechanism.axes for name in FULL_PARAMTPL)]
    setting = {"calib_model": "full_params", "param_name": names, "start_frame": "base", "end_frame": "flange",
               "NbMarkers": 1, "actJoint_idx": list(range(1, 8)), "calibration_index": 3, "NbSample": len(positions),
               "measurability": [True] * 3 + [False] * 3}
    measured = problem.observations[0].recorded.T.ravel()
    start = np.concatenate([*WORLD, [0.05, 0.02, 0.08]])
    begin = time.process_time()
    few = positions[:100]
    jacobian = figaroh.measurement_jacobian(model, data, np.concatenate([start, np.zeros(42)]), few, setting)
    kept, _ = figaroh.select_identifiable_parameters(jacobian, names, ends)
    setting["param_name"] = kept

    def residual(parameters: np.ndarray) -> np.ndarray:
        return (measured - figaroh.calc_updated_fkm(model, data, parameters, positions, setting)) / U_POINT
    found = least_squares(residual, np.concatenate([start, np.zeros(len(kept) - len(ends))]), method="lm")
    np.linalg.inv(found.jac.T @ found.jac)
    return time.process_time() - begin, 2 * found.cost, len(kept)


def main() -> None:
    print("parameters poses |   calib [s]  objective  sum of redundancy |  scipy lm, differences [s]  objective | "
          "scipy lm, our Jacobian [s]")
    for families in ((), ("encoder",), ("encoder", "sag", "scale"), ("encoder", "sag", "scale", "second"),
                     ("encoder", "sag", "scale", "second", "third")):
        problem, _ = declared(families, 1000)
        first, estimate, redundancy = ours(problem)
        free = len(System(problem).layout.free_columns)
        by_differences, objective, _ = scipys(problem, analytic=False)
        with_ours, _, _ = scipys(problem, analytic=True)
        print(f"{free:10d} {1000:5d} | {first:11.2f} {estimate.objective:10.3f} {redundancy:18.3f} | "
              f"{by_differences:27.2f} {objective:10.3f} | {with_ours:.2f}", flush=True)
    problem, positions = points(1000)
    seconds, estimate, redundancy = ours(problem)
    free = len(System(problem).layout.free_columns)
    print(f"points: calib   {free} parameters {seconds:.2f} s, objective {estimate.objective:.3f}, sum of redundancy "
          f"{redundancy:.1f}", flush=True)
    try:
        seconds, objective, kept = figarohs(problem, positions)
    except ImportError:
        print("figaroh is not installed")
        return
    print(f"points: figaroh {kept} parameters {seconds:.2f} s, objective {objective:.3f}")


if __name__ == "__main__":
    main()

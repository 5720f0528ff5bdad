import casadi as ca
import numpy as np
import pytest
from shipped import EXAMPLES, example_with_effects, plausible_values

from calib.rows import CHUNK, Program
from calib.system import System

# NumPy brings its own versions of these, which may round the last digit otherwise than the C library that CasADi calls.
NUMPY_ROUNDS = {getattr(ca, f"OP_{name}") for name in
                ("SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN", "ATAN2", "EXP", "LOG", "POW", "CONSTPOW", "SINH", "COSH",
                 "TANH", "ASINH", "ACOSH", "ATANH", "LOG1P", "EXPM1", "ERF", "HYPOT")}
STENCIL = np.array([4 / 5, -1 / 5, 4 / 105, -1 / 280])       # central differences of order 8
SHARP = 1e-6                                                 # what differences must resolve of a derivative
COARSER = np.array([3 / 4, -3 / 20, 1 / 60, 0.0])            # and of order 6
ALL = [(name, group) for name in EXAMPLES for group in range(
    sum(len(kind) for kind in (example_with_effects(name).observations, example_with_effects(name).constraints,
                               example_with_effects(name).quantities)))]


def bound_model(name, number):
    """One bound model of an example with all effects at plausible sizes, and stored values."""
    problem = example_with_effects(name)
    system = System(problem)
    term = (*system.terms, *system.conditions, *system.results.values())[number]
    return term, plausible_values(problem, system, seed=1)


def inputs_of(term, values):
    """Stored numbers and data of every row, (width, n)."""
    return np.array([np.broadcast_to(column, (term.n,)) for column in term._inputs(values)])


def columns_of(parts, term):
    """Derivatives (n, dim, F) side by side."""
    return np.concatenate([p.jacobian for p in parts], axis=2) if parts else np.zeros((term.n, term.dim, 0))


def moving(term):
    """Local coordinates of the unknowns among the arguments."""
    return ca.vertcat(*[s for s, known in zip(term.traced.symbols.local, term.any_unknown, strict=True) if known])


@pytest.mark.parametrize(("name", "number"), ALL)
def test_all_rows_at_once_are_the_rows_one_by_one(name, number):
    term, values = bound_model(name, number)
    symbols, prediction = term.traced.symbols, term.traced.prediction
    known = [s for s, there in zip(symbols.local, term.any_unknown, strict=True) if there]
    derivatives = term.traced.derivatives(known)
    at_rest = ca.substitute([prediction, *derivatives], symbols.local, [ca.SX.zeros(s.shape) for s in symbols.local])
    stored, flat = ca.vertcat(*symbols.ambient), ca.vertcat(*[ca.densify(ca.vec(e)) for e in at_rest])
    row = ca.Function("row", [stored], [flat])
    inputs = inputs_of(term, values)
    one_by_one = np.column_stack([np.array(row(inputs[:, i])).ravel() for i in range(term.n)])
    predicted, parts = term.derive(values, held_too=True)
    found = np.concatenate([predicted.T, *(p.jacobian.transpose(2, 1, 0).reshape(-1, term.n) for p in parts)])
    assert np.all(np.isfinite(found)) and found.shape == one_by_one.shape
    if not NUMPY_ROUNDS & {row.instruction_id(k) for k in range(row.n_instructions())}:
        np.testing.assert_array_equal(found, one_by_one)
        return
    shift = ca.mtimes(ca.fabs(ca.jacobian(flat, stored)), ca.fabs(stored))
    change = ca.Function("change", [stored], [ca.fabs(flat) + shift])
    rounding = np.column_stack([np.array(change(inputs[:, i])).ravel() for i in range(term.n)])
    assert np.all(np.abs(found - one_by_one) <= 16 * np.finfo(float).eps * rounding)


def differences(function, inputs, sizes, expected_size):
    """Derivatives (columns, outputs, rows) by central differences, and how uncertain they are.

    The smallest step that is sharp enough is taken: a larger one may stride over a fine structure, as a cyclic error.
    """
    best, doubt, before = 0.0, np.inf, np.inf
    for exponent in np.arange(-10.0, 0.5, 0.5):
        h = sizes * 10.0**exponent
        fine = coarse = 0.0
        for k in range(1, 5):
            ahead, behind = (function(inputs, sign * k * np.diag(h)) for sign in (1, -1))
            change = (ahead - behind) / h[:, None, None]
            fine, coarse = fine + STENCIL[k - 1] * change, coarse + COARSER[k - 1] * change
        # order 6 against 8 shows what is left out, the last digit and the next smaller step how much is rounding
        digit = 8 * np.finfo(float).eps * (1.0 + np.abs(ahead)) / h[:, None, None]     # of coordinates of about a metre
        error = np.nan_to_num(np.maximum(np.abs(fine - coarse), np.abs(fine - before)) + digit, nan=np.inf)
        before = fine
        better = (error < doubt) & ~(doubt <= SHARP * expected_size)
        best, doubt = np.where(better, np.nan_to_num(fine), best), np.where(better, error, doubt)
        if np.all((doubt <= SHARP * expected_size) | ((expected_size == 0.0) & (exponent > -4.0))):
            break
    return best, doubt


def sizes_of(term):
    """How far each local coordinate may be moved: one for lengths and angles, the plausible size for effects."""
    sizes = []
    for feed, source, known in zip(term.feeds, term.traced.sources, term.any_unknown, strict=True):
        if known:
            sizes += [float(s) for s in np.broadcast_to(PLAUSIBLE.get(feed.unknown, 1.0), (source.freedom,))]
    return np.array(sizes)


PLAUSIBLE = {attached.unknown: [p.plausible[1] for p in attached.effect.parameters]
             for name in EXAMPLES for attached in example_with_effects(name).attached}


def spread_rows(term, most):
    return np.unique(np.linspace(0, term.n - 1, most).round().astype(int))


def evaluated(term, expression):
    """Function (inputs (width, rows), local steps (steps, F)) -> values (steps, outputs, rows), by CasADi alone."""
    symbols = term.traced.symbols
    fixed = [s for s, known in zip(symbols.local, term.any_unknown, strict=True) if not known]
    if fixed:
        expression = ca.substitute([expression], fixed, [ca.SX.zeros(s.shape) for s in fixed])[0]
    function = ca.Function("moved", [ca.vertcat(*symbols.ambient), moving(term)], [ca.densify(expression)])

    def values(inputs, steps):
        rows = inputs.shape[1]
        flat = np.array(function(np.tile(inputs, len(steps)), np.repeat(steps, rows, axis=0).T))
        return flat.reshape(-1, len(steps), rows).transpose(1, 0, 2)
    return values


@pytest.mark.parametrize(("name", "number"), ALL)
def test_derivatives_are_those_of_finite_differences(name, number):
    term, values = bound_model(name, number)
    rows = spread_rows(term, 3)
    predicted, parts = term.derive(values, held_too=True)
    everywhere = columns_of(parts, term).transpose(2, 1, 0)
    size, scale = np.abs(everywhere).max(axis=(1, 2), keepdims=True), sizes_of(term)
    function = evaluated(term, term.traced.prediction)
    found, doubt = differences(function, inputs_of(term, values)[:, rows], scale, size)
    assert np.all(np.abs(found - everywhere[:, :, rows]) <= SHARP * size + 10 * doubt)
    seen = size[:, 0, 0] * scale > 2e-9 * (1.0 + np.abs(predicted).max())       # not so flat that rounding hides it
    assert np.all((doubt <= 10 * SHARP * size)[seen])


@pytest.mark.parametrize(("name", "number"), ALL)
@pytest.mark.slow
def test_second_derivatives_are_those_of_finite_differences(name, number):
    term, values = bound_model(name, number)
    if term.traced.affine or not any(term.any_free):
        return
    weights = np.cos(np.arange(term.n * term.dim)).reshape(term.n, term.dim)
    _, hessians = term.curvature(values, weights)
    assert_bend_is_hessian_times_step(term, values, weights)
    free = ca.vertcat(*[s for s, want in zip(term.traced.symbols.local, term.any_free, strict=True) if want])
    sizes = [np.full(s.shape[0], want) for s, want, known in
             zip(term.traced.symbols.local, term.any_free, term.any_unknown, strict=True) if known]
    chosen = np.concatenate(sizes).astype(bool)
    for row in [term.n // 2]:
        slope = evaluated(term, ca.jacobian(ca.dot(ca.DM(weights[row]), term.traced.prediction), free).T)

        def moved(inputs, steps, slope=slope):
            whole = np.zeros((len(steps), len(chosen)))
            whole[:, chosen] = steps
            return slope(inputs, whole)
        size = np.abs(hessians[row]).max()
        found, doubt = differences(moved, inputs_of(term, values)[:, [row]], sizes_of(term)[chosen], size)
        assert np.all(np.abs(found[:, :, 0] - hessians[row]) <= SHARP * size + 10 * doubt[:, :, 0])


def assert_bend_is_hessian_times_step(term, values, weights):
    columns, hessians = term.curvature(values, weights)
    size = 1 + max(int(c.max(initial=0)) for c in term.columns)
    step, expected, found, terms = np.sin(1.0 + np.arange(size)), np.zeros(size), np.zeros(size), np.zeros(size)
    np.add.at(expected, columns, np.einsum("nfg,ng->nf", hessians, step[columns]))
    np.add.at(terms, columns, np.einsum("nfg,ng->nf", np.abs(hessians), np.abs(step[columns])))
    term.bend(values, weights)(step, found)
    assert np.all(np.abs(found - expected) <= 1e-9 * terms.max())


def test_more_rows_than_a_chunk_give_the_same_rows():
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    program = Program([x, y], ca.vertcat(x[0] * y, x[1] - y, 3.5))
    n = 2 * CHUNK + 17
    first, second = np.linspace(0.0, 1.0, n), np.linspace(-5.0, 5.0, n)
    found = program([first, 2.0, second], n)
    np.testing.assert_array_equal(found, [first * second, 2.0 - second, np.full(n, 3.5)])


UNARY = [ca.exp, ca.log, ca.sqrt, ca.sin, ca.cos, ca.tan, ca.asin, ca.acos, ca.atan, ca.floor, ca.ceil, ca.fabs,
         ca.sign, ca.erf, ca.sinh, ca.cosh, ca.tanh, ca.asinh, ca.acosh, ca.atanh, ca.log1p, ca.expm1, ca.logic_not,
         lambda x: -x, lambda x: 1 / x, lambda x: x * x, lambda x: x + x, lambda x: x**3, lambda x: x**-0.5]
BINARY = [ca.fmin, ca.fmax, ca.atan2, ca.fmod, ca.remainder, ca.copysign, ca.hypot, ca.logic_and, ca.logic_or,
          lambda x, y: x + y, lambda x, y: x - y, lambda x, y: x * y, lambda x, y: x / y, lambda x, y: x**y,
          lambda x, y: x < y, lambda x, y: x <= y, lambda x, y: x == y, lambda x, y: x != y,
          lambda x, y: ca.if_else(x < y, x, y)]
SAMPLES = np.array([-7.3, -2.0, -1.0, -0.3, -1e-9, 0.0, 1e-9, 0.3, 0.5, 1.0, 1.5, 2.0, 2.5, 7.3, 1e6])


@pytest.mark.parametrize("operation", UNARY + BINARY)
def test_every_operation_is_that_of_casadi(operation):
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    given = (x,) if operation in UNARY else (x, y)
    expression = ca.SX(operation(*given))
    first, second = (grid.ravel() for grid in np.meshgrid(SAMPLES, SAMPLES))
    found = Program([x, y], expression)([first, second], len(first))[0]
    exact = ca.Function("f", [x, y], [expression])
    expected = np.array([float(exact(a, b)) for a, b in zip(first, second, strict=True)])
    np.testing.assert_allclose(found, expected, rtol=4 * np.finfo(float).eps, atol=0.0, equal_nan=True)


def test_an_unknown_operation_is_named():
    x = ca.SX.sym("x")
    with pytest.raises(NotImplementedError, match="operation"):
        Program([x], ca.SX(ca.erfinv(x)))

"""Compiled rows against CasADi and NumPy, their cache on disk, and life without the compiler."""

import sys

import casadi as ca
import numpy as np
import pytest
from shipped import EXAMPLES
from test_rows import ALL, BINARY, NUMPY_ROUNDS, SAMPLES, UNARY, bound_model, inputs_of

from calib.compiled import available, pays, row_back_end, threads
from calib.compiled.machine import cache_folder, compiler
from calib.errors import CalibrationError
from calib.rows import Program

here = pytest.mark.skipif(not available(), reason="llvmlite is not installed")


@pytest.fixture(scope="module", autouse=True)
def own_cache(tmp_path_factory):
    """Nothing is read from or left in the cache folder of whoever runs the tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CALIB_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.delenv("CALIB_ROWS", raising=False)
        yield


@pytest.fixture
def fresh():
    """A compiler that has compiled nothing yet, as in a new process."""
    compiler.cache_clear()
    yield
    compiler.cache_clear()


def small():
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    return Program([x, y], ca.vertcat(ca.sin(x[0]) * y, x[1] - y, 3.5, ca.atan2(x[0], x[1])))


def columns(n, seed=1):
    generator = np.random.default_rng(seed)
    return [generator.normal(size=n), generator.normal(size=n), 2.5]


def casadi_rows(expressions, symbols, inputs):
    """Values (outputs, rows) by CasADi, one row after the other."""
    function = ca.Function("row", symbols, [ca.vertcat(*[ca.densify(ca.vec(e)) for e in expressions])])
    return function, np.column_stack([np.array(function(column)).ravel() for column in inputs.T])


def compare(term, values, wanted):
    """Compiled rows of a bound model: CasADi's to the last digit, NumPy's too where it has no functions of its own."""
    program, symbols = term.traced.program(wanted), term.traced.symbols
    inputs = inputs_of(term, values)
    local = [s for s, want in zip(symbols.local, wanted, strict=True) if want]
    derivatives = term.traced.derivatives(local)
    zeros = [ca.SX.zeros(s.shape) for s in symbols.local]
    at_rest = ca.substitute([term.traced.prediction, *derivatives], symbols.local, zeros)
    function, exact = casadi_rows(at_rest, [ca.vertcat(*symbols.ambient)], inputs)
    found = program.run(list(inputs), term.n, compiled=True)
    np.testing.assert_array_equal(found, exact)
    if not NUMPY_ROUNDS & {function.instruction_id(k) for k in range(function.n_instructions())}:
        np.testing.assert_array_equal(found, program.run(list(inputs), term.n, compiled=False))


@here
@pytest.mark.parametrize(("name", "number"), ALL)
def test_compiled_predictions_of_every_model_are_those_of_casadi(name, number):
    term, values = bound_model(name, number)
    compare(term, values, (False,) * len(term.feeds))


@here
@pytest.mark.slow
@pytest.mark.parametrize(("name", "number"), ALL)
def test_compiled_derivatives_of_every_model_are_those_of_casadi(name, number):
    term, values = bound_model(name, number)
    compare(term, values, term.any_unknown)


@here
def test_compiled_rows_of_numpy_differ_by_the_rounding_of_its_own_functions_only():
    for name in EXAMPLES:
        term, values = bound_model(name, 0)
        program, inputs = term.traced.program((False,) * len(term.feeds)), list(inputs_of(term, values))
        first, second = (program.run(inputs, term.n, compiled=way) for way in (True, False))
        size = np.maximum(np.abs(first), max(1.0, np.abs(np.array(inputs)).max(initial=0.0)))
        assert np.abs(first - second).max() <= 64 * np.finfo(float).eps * size.max(), name


@here
def test_every_operation_compiled_is_that_of_casadi_bit_for_bit():
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    expressions = ca.vertcat(*[f(x) for f in UNARY], *[f(x, y) for f in BINARY])
    first, second = (grid.ravel() for grid in np.meshgrid(SAMPLES, SAMPLES))
    found = Program([x, y], expressions).run([first, second], len(first), compiled=True)
    exact = ca.Function("f", [x, y], [expressions])
    expected = np.column_stack([np.array(exact(a, b)).ravel() for a, b in zip(first, second, strict=True)])
    np.testing.assert_array_equal(found, expected)


@here
@pytest.mark.parametrize("n", [0, 1, 3, 8, 13, 16, 1000])
def test_any_number_of_rows_gives_the_same_rows(n):
    program, many = small(), columns(1000)
    whole = program.run(many, 1000, compiled=True)
    found = program.run([c[:n] if np.ndim(c) else c for c in many], n, compiled=True)
    np.testing.assert_array_equal(found, whole[:, :n])


@here
def test_columns_of_any_layout_and_numbers_in_place_of_columns_give_the_same_rows():
    program, (a, b, c) = small(), columns(100)
    expected = program.run([a, b, np.full(100, c)], 100, compiled=True)
    np.testing.assert_array_equal(program.run([a, np.stack([b, b], 1)[:, 1], c], 100, compiled=True), expected)
    whole = np.arange(100)
    np.testing.assert_array_equal(program.run([whole, b, 2], 100, compiled=True),
                                  program.run([whole.astype(float), b, 2.0], 100, compiled=True))


@here
def test_threads_share_the_rows_and_change_no_digit(monkeypatch):
    program, n = small(), 1_200_007
    monkeypatch.setenv("CALIB_THREADS", "1")
    alone = program.run(columns(n), n, compiled=True)
    monkeypatch.setenv("CALIB_THREADS", "3")
    assert threads() == 3
    np.testing.assert_array_equal(program.run(columns(n), n, compiled=True), alone)


# --- when rows are compiled --------------------------------------------------------------------------------------


@here
def test_few_rows_stay_with_numpy_and_many_are_compiled():
    assert not pays(400, 10 * 100)
    assert not pays(10, 1e6)
    assert pays(400, 1e8)


def test_the_caller_may_choose_the_back_end(monkeypatch):
    monkeypatch.setenv("CALIB_ROWS", "numpy")
    assert not pays(400, 1e12)
    with pytest.raises(CalibrationError, match="'gpu' does not exist"), row_back_end("gpu"):
        pass
    if available():
        with row_back_end("compiled"):
            assert pays(1, 1)
    assert not pays(400, 1e12)


@here
def test_a_solve_with_compiled_rows_is_that_with_numpy():
    from shipped import example

    from calib import solve

    problem = example("problems.circle")
    first = solve(problem)
    with row_back_end("compiled"):
        second = solve(problem)
    for unknown, value in first.values.items():
        np.testing.assert_allclose(second.values[unknown], value, rtol=0, atol=1e-12)


# --- without the compiler, and with it from the cache -------------------------------------------------------------


def test_without_llvmlite_numpy_does_everything(fresh, monkeypatch):
    for name in ("llvmlite", "llvmlite.binding"):
        monkeypatch.setitem(sys.modules, name, None)
    assert not available() and not pays(400, 1e12)
    program, inputs = small(), columns(50)
    np.testing.assert_array_equal(program(inputs, 50), program.run(inputs, 50, compiled=False))
    with pytest.raises(CalibrationError, match="fast"), row_back_end("compiled"):
        pass
    with pytest.raises(CalibrationError, match="llvmlite"):
        program.run(inputs, 50, compiled=True)


def the_file(folder):
    (path,) = (folder / "rows").iterdir()
    return path


@here
def test_a_second_process_finds_the_code_of_the_first(fresh, monkeypatch, tmp_path):
    monkeypatch.setenv("CALIB_CACHE", str(tmp_path))
    inputs = columns(50)
    expected = small().run(inputs, 50, compiled=True)
    before = the_file(tmp_path).stat()
    compiler.cache_clear()
    np.testing.assert_array_equal(small().run(inputs, 50, compiled=True), expected)
    after = the_file(tmp_path).stat()
    assert (after.st_ino, after.st_mtime_ns) == (before.st_ino, before.st_mtime_ns)


@here
@pytest.mark.parametrize("damage", [lambda code: code[: len(code) // 2], lambda code: b"", lambda code: b"rubbish" * 99,
                                    lambda code: code[:-9] + bytes([code[-9] ^ 1]) + code[-8:]])
def test_a_damaged_cache_is_compiled_again(fresh, monkeypatch, tmp_path, damage):
    monkeypatch.setenv("CALIB_CACHE", str(tmp_path))
    inputs = columns(50)
    expected = small().run(inputs, 50, compiled=True)
    path = the_file(tmp_path)
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    compiler.cache_clear()
    np.testing.assert_array_equal(small().run(inputs, 50, compiled=True), expected)
    assert the_file(tmp_path).read_bytes() == whole


@here
def test_code_that_others_may_write_is_not_run(fresh, monkeypatch, tmp_path):
    monkeypatch.setenv("CALIB_CACHE", str(tmp_path))
    small().run(columns(50), 50, compiled=True)
    path = the_file(tmp_path)
    path.chmod(0o666)
    compiler.cache_clear()
    small().run(columns(50), 50, compiled=True)
    assert the_file(tmp_path).stat().st_mode & 0o077 == 0


@here
def test_a_cache_folder_that_cannot_be_written_stops_nothing(fresh, monkeypatch, tmp_path):
    occupied = tmp_path / "file"
    occupied.write_text("")
    monkeypatch.setenv("CALIB_CACHE", str(occupied))
    assert cache_folder().parent == occupied
    inputs = columns(50)
    assert np.isfinite(small().run(inputs, 50, compiled=True)).all()

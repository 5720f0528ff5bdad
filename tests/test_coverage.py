"""Stated intervals cover the truth in every shipped example: 50 repetitions here, 500 in benchmarks/coverage.py."""

import numpy as np
import pytest
from shipped import EXAMPLES, example, modules

from calib import solve
from calib.workflow.coverage import coverage

MEASURED = [n for n in EXAMPLES if getattr({m.__name__: m for m in modules()}[n], "measures", True)]


@pytest.mark.slow
@pytest.mark.parametrize("name", MEASURED)
def test_ninety_five_per_cent_intervals_cover_ninety_five_per_cent(name):
    problem = example(name)
    if any(not c.is_equality for c in problem.constraints):
        pytest.skip("inequalities: the intervals of an active bound are not symmetric")
    found = coverage(solve(problem), range(1, 51))
    assert found.failures == 0
    # One result is a binomial count of 50; results of one problem are correlated: their mean is no surer than one.
    assert found.covered.mean() == pytest.approx(0.95, abs=0.09), dict(zip(found.names, found.covered, strict=True))
    assert np.sqrt(np.mean(found.errors**2)) == pytest.approx(1.0, abs=0.3)

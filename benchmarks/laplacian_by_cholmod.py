"""Laplacian editing solved by CHOLMOD: a process that ``baselines.py`` starts, if cvxopt is there.

CHOLMOD's supernodal factorisation is under the GPL, as is cvxopt, which brings it along: they run
here and nowhere else, and nothing of the program imports them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module

import numpy as np
import numpy.typing as npt
from scipy import sparse

from sgp._paper.laplacian import LaplacianEditing
from sgp._paper.measure import run_methods

Double = npt.NDArray[np.float64]
METHOD = "LAPL, CHOLMOD"


def by_cholmod(matrix: sparse.csc_array) -> Callable[[Double], Double]:
    """Factorise by CHOLMOD: approximate minimum degree, supernodes."""
    cvxopt, cholmod = import_module("cvxopt"), import_module("cvxopt.cholmod")
    cholmod.options["supernodal"] = 2
    lower = sparse.coo_array(sparse.tril(matrix))
    given = cvxopt.spmatrix(lower.data, lower.row, lower.col, lower.shape)
    factors = cholmod.symbolic(given)
    cholmod.numeric(given, factors)

    def solve(b: Double) -> Double:
        x = cvxopt.matrix(b)
        cholmod.solve(factors, x)
        return np.array(x)

    return solve


if __name__ == "__main__":
    run_methods(sys.argv[1:], {METHOD: partial(LaplacianEditing, factorise=by_cholmod)})

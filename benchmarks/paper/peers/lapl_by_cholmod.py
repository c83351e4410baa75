"""Laplacian editing solved by CHOLMOD, in a process that ``baselines.py`` starts.

It needs cvxopt. CHOLMOD's supernodal factorisation and cvxopt, which contains it, are under the
GPL: they are used only here, and the program never imports them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module

import numpy as np
from scipy import sparse

from benchmarks.paper.measure import run_methods
from benchmarks.paper.peers.lapl import LaplacianEditing
from rig.arrays import Float64

METHOD = "LAPL, CHOLMOD"


def by_cholmod(matrix: sparse.csc_array) -> Callable[[Float64], Float64]:
    """Factorise with CHOLMOD: approximate minimum degree, supernodes."""
    cvxopt, cholmod = import_module("cvxopt"), import_module("cvxopt.cholmod")
    cholmod.options["supernodal"] = 2
    lower = sparse.coo_array(sparse.tril(matrix))
    system = cvxopt.spmatrix(lower.data, lower.row, lower.col, lower.shape)
    factors = cholmod.symbolic(system)
    cholmod.numeric(system, factors)

    def solve(b: Float64) -> Float64:
        x = cvxopt.matrix(b)
        cholmod.solve(factors, x)
        return np.array(x)

    return solve


if __name__ == "__main__":
    run_methods(sys.argv[1:], {METHOD: partial(LaplacianEditing, factorise=by_cholmod)})

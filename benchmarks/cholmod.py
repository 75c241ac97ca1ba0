"""CHOLMOD, supernodal, as cvxopt brings it."""

from __future__ import annotations

from typing import Any

import numpy as np
from cvxopt import amd, cholmod, matrix, spmatrix

from benchmarks.system import System
from masat.arrays import Floats, Ids


class Cholmod:
    """A system in CHOLMOD's form, and its steps as tasks to time."""

    def __init__(self, system: System, order: Ids | None = None) -> None:
        """Analyze in CHOLMOD's own ordering, or in this one of the unknowns."""
        self._matrix = _sparse(system.rows, system.columns, system.values, system.size)
        self._order = None if order is None else matrix(order)
        self._factor = self.analyze()

    def analyze(self) -> Any:
        """Order, and find the pattern of the factor."""
        # 0: the best of those that CHOLMOD knows; 1: the one given.
        if self._order is None:
            cholmod.options["nmethods"] = 0
            return cholmod.symbolic(self._matrix)
        cholmod.options["nmethods"] = 1
        return cholmod.symbolic(self._matrix, p=self._order)

    def factorize(self) -> None:
        """Factorize the numbers."""
        cholmod.numeric(self._matrix, self._factor)

    def solve(self, b: Floats) -> Floats:
        """Solve with the factor."""
        x = matrix(b)
        cholmod.solve(self._factor, x)
        return np.array(x).ravel()


def block_order(system: System, dof: int) -> Ids:
    """Return AMD's ordering of the nodes, as one of their unknowns."""
    rows, columns = system.rows // dof, system.columns // dof
    nodes = np.array(amd.order(_sparse(rows, columns, np.ones(len(rows)), system.size // dof)))
    return np.asarray(dof * nodes.reshape(-1, 1) + np.arange(dof), np.int64).ravel()


def _sparse(rows: Ids, columns: Ids, values: Floats, size: int) -> Any:
    return spmatrix(matrix(values), matrix(rows), matrix(columns), (size, size))

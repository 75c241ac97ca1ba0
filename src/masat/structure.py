"""The order in which the nodes of a graph are eliminated from its sparse systems."""

from __future__ import annotations

import numpy as np

from masat import _core
from masat.arrays import Flags, Indices

# Operations a node, of one factorization by minimum degree, above which nested dissection pays:
# it takes some 4 us a node, and saves up to half of each of the few factorizations of a solve.
_WORTH_DISSECTING = 3e5


def eliminate(topology: _core.Topology, held: Flags, block_size: int) -> _core.Elimination:
    """Return the cheaper order of those known, by the counted operations of a factorization.

    Minimum degree (Amestoy, Davis, Duff, An approximate minimum degree ordering algorithm, 1996);
    where that leaves much work, also nested dissection (Karypis and Kumar, A fast and high quality
    multilevel scheme for partitioning irregular graphs, 1998), if the package pymetis is there.
    """
    by_degree = _core.Elimination(topology, held, np.empty(0, np.int32))
    work = by_degree.operations(block_size)
    if work <= _WORTH_DISSECTING * np.count_nonzero(~held):
        return by_degree
    order = nested_dissection(by_degree)
    if order is None:
        return by_degree
    dissected = _core.Elimination(topology, held, order)
    return dissected if dissected.operations(block_size) < work else by_degree


def nested_dissection(elimination: _core.Elimination) -> Indices | None:
    """Return the place of the free node to eliminate k-th, by METIS; None without pymetis."""
    try:
        import pymetis
    except ImportError:
        return None
    start, neighbors = elimination.adjacency()
    order, _ = pymetis.nested_dissection(pymetis.CSRAdjacency(start, neighbors))
    return np.array(order, np.int32)

"""Random operations on a map that grows, beside threads that read it."""

import pytest

stress = pytest.importorskip("benchmarks.online_stress").stress


@pytest.mark.parametrize("dimension", [2, 3])
def test_random_operations_beside_readers_on_the_threads(dimension):
    counts, reads = stress(dimension, 300, seed=dimension, most_nodes=50)
    assert sum(counts.values()) >= 300
    assert reads > 10

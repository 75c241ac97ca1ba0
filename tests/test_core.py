"""The native module refuses what its Python callers never send."""

import numpy as np
import pytest

from masat import _core

FLOATS = {2: np.zeros((2, 3)), 3: np.tile([0, 0, 0, 0, 0, 0, 1.0], (2, 1))}


EDGE = np.array([[0, 1]], np.int32)


def topology():
    return _core.Topology(2, EDGE)


def elimination(fixed, order=()):
    return _core.Elimination(topology(), fixed=fixed, order=np.array(order, np.int32))


@pytest.mark.parametrize("edge", [[0, 2], [-1, 0]])
def test_edges_out_of_range_are_refused(edge):
    with pytest.raises(ValueError, match="out of range"):
        _core.Topology(2, np.array([edge], np.int32))


def test_a_negative_number_of_nodes_is_refused():
    with pytest.raises(ValueError, match="must not be negative"):
        _core.Topology(-1, np.empty((0, 2), np.int32))


def test_a_graph_without_nodes_has_no_components():
    graph = _core.Topology(0, np.empty((0, 2), np.int32))
    assert len(graph.components()) == 0
    assert len(graph.incident_edges(np.empty(0, bool))) == 0
    none, poses = np.empty(0, np.int32), np.empty((0, 3))
    assert _core.place_by_masat(graph, none, poses, poses).shape == (0, 3)
    assert _core.place_most_informed_first(graph, none, poses, poses).shape == (0, 3)


@pytest.mark.parametrize("seed", range(5))
def test_incident_edges_are_those_with_a_flagged_end(seed):
    rng = np.random.default_rng(seed)
    # Loops from a node to itself and repeated edges included.
    edges = rng.integers(12, size=(30, 2)).astype(np.int32)
    graph = _core.Topology(12, edges)
    for fraction in (0, 0.2, 0.7, 1):
        flags = rng.random(12) < fraction
        found = graph.incident_edges(flags)
        assert found.dtype == np.int64
        assert np.array_equal(found, np.flatnonzero(flags[edges].any(axis=1)))
    with pytest.raises(ValueError, match="one flag a node"):
        graph.incident_edges(np.zeros(3, bool))


def test_a_root_given_twice_is_refused():
    a, z, roots = FLOATS[2], FLOATS[2][:1], np.array([0, 1, 0], np.int32)
    none, w = np.empty(0, bool), np.eye(3)[None]
    with pytest.raises(ValueError, match="root twice"):
        _core.place_by_masat(topology(), roots, z, a)
    with pytest.raises(ValueError, match="root twice"):
        _core.place_most_informed_first(topology(), roots, z, a)
    with pytest.raises(ValueError, match="root twice"):
        _core.place_along_tree(topology(), roots, none, z, a)
    with pytest.raises(ValueError, match="root twice"):
        _core.place_by_toro(topology(), roots, z, w, a, 1)


def test_arrays_that_do_not_fit_are_refused():
    a = FLOATS[2]
    with pytest.raises(ValueError, match="3 or 7"):
        _core.inverse(np.zeros((2, 4)))
    with pytest.raises(ValueError, match="same shape"):
        _core.compose(a, FLOATS[3])
    with pytest.raises(ValueError, match="3 or 6"):
        _core.retract(a, np.zeros((2, 6)))
    with pytest.raises(ValueError, match="3x3 or 6x6"):
        _core.indefinite(np.zeros((1, 4, 4)))
    with pytest.raises(ValueError, match="root out of range"):
        _core.place_by_masat(topology(), np.array([5], np.int32), a[:1], a)
    with pytest.raises(ValueError, match="root out of range"):
        _core.place_most_informed_first(topology(), np.array([-1], np.int32), a[:1], a)
    with pytest.raises(ValueError, match="measurements must be"):
        _core.place_by_masat(topology(), np.array([0], np.int32), a, a)
    with pytest.raises(ValueError, match="preferred"):
        _core.place_along_tree(topology(), np.array([0], np.int32), np.ones(3, bool), a[:1], a)
    with pytest.raises(ValueError, match=r"\(m, d, d\)"):
        _core.place_by_toro(topology(), np.array([0], np.int32), a[:1], np.zeros((1, 6, 6)), a, 1)
    with pytest.raises(ValueError, match="sweeps"):
        _core.place_by_toro(topology(), np.array([0], np.int32), a[:1], np.eye(3)[None], a, -1)


def test_an_elimination_refuses_what_does_not_fit():
    with pytest.raises(ValueError, match="one flag a node"):
        elimination(np.zeros(1, bool))
    with pytest.raises(ValueError, match="each free node once"):
        elimination(np.zeros(2, bool), [0])
    with pytest.raises(ValueError, match="permutation"):
        elimination(np.zeros(2, bool), [1, 1])
    with pytest.raises(ValueError, match="permutation"):
        elimination(np.zeros(2, bool), [0, 2])


@pytest.mark.parametrize("factorized", ["never", "with a failed pivot"])
def test_only_a_successful_factorization_is_solved_with(factorized):
    index = np.zeros(1, np.int32)
    fixed = np.array([True, False])
    matrix = _core.GraphMatrix(elimination(fixed), 2)
    equations = _core.NormalEquations(
        topology(), elimination(fixed), FLOATS[2][:1], np.eye(3)[None]
    )
    if factorized != "never":
        equations.linearize(FLOATS[2])
        # A success before must not count.
        assert matrix.factorize(np.ones(2)) == -1
        assert equations.factorize(np.ones(3)) == -1
        assert matrix.factorize(np.array([1.0, -1.0])) == 0
        assert equations.factorize(np.array([1.0, -9.0, 1.0])) == 1
    for call in (
        lambda: matrix.solve(np.zeros((1, 2, 1))),
        lambda: matrix.inverse(index, index),
        lambda: matrix.pivot_ratio(),
        lambda: equations.solve(),
        lambda: equations.inverse(index, index),
        lambda: equations.pivot_ratio(),
    ):
        with pytest.raises(RuntimeError, match="the matrix is not factorized: call factorize"):
            call()
    assert matrix.factorize(np.array([2.0, 4.0])) == -1
    assert np.allclose(matrix.solve(np.ones((1, 2, 1))).ravel(), [0.5, 0.25], rtol=1e-15)
    assert np.allclose(matrix.inverse(index, index)[0], np.diag([0.5, 0.25]), rtol=1e-15)


@pytest.mark.parametrize("threads", [2**31, -(2**31) - 1, 1.5])
def test_numbers_of_threads_that_are_no_c_integers_are_refused(threads):
    with pytest.raises(TypeError):
        _core.NormalEquations(
            topology(),
            elimination(np.array([True, False])),
            FLOATS[2][:1],
            np.eye(3)[None],
            threads,
        )


def test_equations_refuse_what_does_not_fit():
    a = FLOATS[2]
    fixed = np.array([True, False])
    with pytest.raises(ValueError, match=r"\(m, d, d\)"):
        _core.NormalEquations(topology(), elimination(fixed), a[:1], np.zeros((1, 6, 6)))
    with pytest.raises(ValueError, match="same graph"):
        _core.NormalEquations(_core.Topology(3, EDGE), elimination(fixed), a[:1], np.eye(3)[None])
    equations = _core.NormalEquations(topology(), elimination(fixed), a[:1], np.eye(3)[None])
    with pytest.raises(ValueError, match="poses must be"):
        equations.chi2(FLOATS[3])
    with pytest.raises(ValueError, match="damping"):
        equations.factorize(np.zeros(6))
    with pytest.raises(ValueError, match="step"):
        equations.retract(a, np.zeros(6))


def test_equations_without_unknowns_have_an_empty_solution():
    all_fixed = elimination(np.ones(2, bool))
    equations = _core.NormalEquations(topology(), all_fixed, FLOATS[2][:1], np.eye(3)[None])
    assert equations.linearize(FLOATS[2]) == 0
    assert equations.factorize(np.zeros(0)) == -1
    assert equations.solve().shape == (0,)
    assert equations.pivot_ratio() == 1


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_whole_optimization_runs(dimension):
    z = FLOATS[dimension].copy()
    z[:, 0] = 1
    poses = FLOATS[dimension].copy()
    dof = 3 * (dimension - 1)
    edges = np.array([[0, 1], [1, 0]], np.int32)
    graph = _core.Topology(2, edges)
    placed = _core.place_by_masat(graph, np.array([0], np.int32), z, poses)
    order = _core.Elimination(graph, np.array([True, False]), np.empty(0, np.int32))
    equations = _core.NormalEquations(graph, order, z, np.tile(np.eye(dof), (2, 1, 1)))
    equations.linearize(placed)
    assert equations.factorize(np.zeros(dof)) == -1
    moved = equations.retract(placed, equations.solve())
    # One edge says +1, the other -1.
    assert np.allclose(moved[1, :dimension], 0)
    assert np.isclose(equations.chi2(moved), 2)


@pytest.mark.parametrize("angle", [0.0, 1.5, -3.0, 9.9e4, 1.1e5, -1e12])
def test_sine_and_cosine_are_the_library_s_to_the_last_places(angle):
    # A pose times (1, 0, 0) lies at its cosine and sine, one by one and in bulk.
    many = np.tile([0.0, 0.0, angle], (130, 1)) + np.arange(130)[:, None] * [0, 0, 0.37]
    ahead = np.tile([1.0, 0.0, 0.0], (130, 1))
    moved = _core.compose(many, ahead)
    expected = np.column_stack([np.cos(many[:, 2]), np.sin(many[:, 2])])
    assert np.allclose(moved[:, :2], expected, rtol=0, atol=4e-16)
    nodes = len(many)
    star = np.column_stack([np.zeros(2 * nodes), np.repeat(np.arange(1, nodes + 1), 2)])
    z = np.repeat(many, 2, axis=0)
    poses = np.zeros((nodes + 1, 3))
    graph = _core.Topology(nodes + 1, star.astype(np.int32))
    heading = _core.place_by_masat(graph, np.array([0], np.int32), z, poses)[1:, 2]
    assert np.allclose(np.cos(heading), expected[:, 0], atol=1e-15)
    assert np.allclose(np.sin(heading), expected[:, 1], atol=1e-15)


@pytest.mark.parametrize("dimension", [2, 3])
def test_equations_keep_alive_what_they_refer_to(dimension):
    random = np.random.default_rng(0)
    nodes, dof = 2000, 3 * (dimension - 1)
    edges = np.column_stack([np.arange(nodes - 1), np.arange(1, nodes)]).astype(np.int32)
    poses = np.tile(FLOATS[dimension][0], (nodes, 1))
    poses[:, :dimension] = random.normal(size=(nodes, dimension))
    fixed = np.arange(nodes) == 0

    def build():
        graph = _core.Topology(nodes, edges.copy())
        order = _core.Elimination(graph, fixed, np.empty(0, np.int32))
        z = np.tile(FLOATS[dimension][0], (nodes - 1, 1))
        return _core.NormalEquations(graph, order, z, np.tile(np.eye(dof), (nodes - 1, 1, 1)))

    equations = build()
    # What was freed would be written over.
    other = [np.full((nodes - 1, k), np.nan) for k in (3, 7, 9, 36, 1) for _ in range(20)]
    chi2 = np.square(np.diff(poses[:, :dimension], axis=0)).sum()
    assert np.isclose(equations.chi2(poses), chi2)
    assert np.isclose(equations.linearize(poses), chi2)
    assert len(other) == 100


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_weight_multiplies_the_information(dimension):
    dof = 3 * (dimension - 1)
    poses, z = FLOATS[dimension].copy(), FLOATS[dimension][:1]
    poses[1, :dimension] = 1
    order = elimination(np.array([True, False]))
    w = np.eye(dof)[None] + 0.1
    weighted = _core.NormalEquations(topology(), order, z, w)
    plain = _core.NormalEquations(topology(), order, z, 2.5 * w)
    assert np.isclose(weighted.linearize(poses, np.array([2.5])), plain.linearize(poses))
    assert np.allclose(weighted.rhs(), plain.rhs())
    assert np.allclose(weighted.diagonal(), plain.diagonal())
    with pytest.raises(ValueError, match="one weight an edge"):
        weighted.linearize(poses, np.ones(2))

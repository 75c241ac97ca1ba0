import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from random_graphs import random_poses

from masat import GraphError, lie

PI = np.pi
H = np.sqrt(0.5)
QUARTER_X = [0, 0, 0, H, 0, 0, H]
QUARTER_Z = [0, 0, 0, 0, 0, H, H]
# There w = sqrt(1 - |v|^2) of the step keeps half of the digits only.
NEAR_HALF_TURNS = 1e-7

coordinates = st.floats(-1e3, 1e3)
angles = st.floats(-10, 10)
quaternions = (
    st.tuples(*[st.floats(-1, 1)] * 4)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)
planar = st.tuples(coordinates, coordinates, angles).map(np.array)
spatial = st.tuples(st.tuples(*[coordinates] * 3).map(np.array), quaternions).map(np.concatenate)


def of_one_group(count):
    return st.one_of(st.tuples(*[planar] * count), st.tuples(*[spatial] * count))


def homogeneous(pose):
    """Return the 3x3 or 4x4 matrix of a pose, written without the package."""
    if len(pose) == 3:
        x, y, theta = pose
        c, s = np.cos(theta), np.sin(theta)
        return np.array([[c, -s, x], [s, c, y], [0, 0, 1]])
    x, y, z, w = pose[3:]
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = pose[:3]
    return matrix


def assert_same_pose(a, b, within=1e-9):
    # Matrices, as q and -q are one rotation, and -pi and pi one heading.
    assert_allclose(homogeneous(a), homogeneous(b), rtol=0, atol=within)


def like(pose):
    return lie.identity(2 if len(pose) == 3 else 3)


@given(of_one_group(3))
def test_composition_is_associative(poses):
    a, b, c = poses
    assert_same_pose(
        lie.compose(lie.compose(a, b), c),
        lie.compose(a, lie.compose(b, c)),
    )


@given(of_one_group(2))
def test_composition_is_the_product_of_the_homogeneous_matrices(poses):
    a, b = poses
    expected = homogeneous(a) @ homogeneous(b)
    assert_allclose(homogeneous(lie.compose(a, b)), expected, rtol=0, atol=1e-9)


@given(of_one_group(1))
def test_the_inverse_is_that_of_the_homogeneous_matrix(poses):
    (a,) = poses
    inverse = homogeneous(lie.inverse(a))
    assert_allclose(inverse, np.linalg.inv(homogeneous(a)), rtol=0, atol=1e-9)


@given(of_one_group(1))
def test_a_pose_and_its_inverse_cancel_on_both_sides(poses):
    (a,) = poses
    assert_same_pose(lie.compose(a, lie.inverse(a)), like(a))
    assert_same_pose(lie.compose(lie.inverse(a), a), like(a))


@given(of_one_group(1))
def test_the_identity_changes_nothing_on_either_side(poses):
    (a,) = poses
    assert_same_pose(lie.compose(a, like(a)), a)
    assert_same_pose(lie.compose(like(a), a), a)


@given(of_one_group(2))
def test_between_leads_from_the_first_pose_to_the_second(poses):
    a, b = poses
    assert_same_pose(lie.compose(a, lie.between(a, b)), b)


@given(of_one_group(2))
def test_retract_undoes_local(poses):
    a, b = poses
    assert_same_pose(lie.retract(a, lie.local(a, b)), b, within=NEAR_HALF_TURNS)


@given(planar, coordinates, coordinates, st.floats(-3.14, 3.14))
def test_local_undoes_retract_in_the_plane(a, x, y, theta):
    step = [x, y, theta]
    assert_allclose(lie.local(a, lie.retract(a, step)), step, rtol=0, atol=1e-9)


@given(spatial, st.tuples(*[coordinates] * 3), st.tuples(*[st.floats(-0.57, 0.57)] * 3))
def test_local_undoes_retract_in_space(a, translation, vector):
    step = [*translation, *vector]
    assert_allclose(lie.local(a, lie.retract(a, step)), step, rtol=0, atol=1e-9)


@given(of_one_group(3))
def test_local_does_not_depend_on_the_frame(poses):
    a, b, frame = poses
    moved = lie.local(lie.compose(frame, a), lie.compose(frame, b))
    step = lie.local(a, b)
    # A half turn has two steps: compare what they do.
    assert_same_pose(lie.retract(a, moved), lie.retract(a, step), within=NEAR_HALF_TURNS)


@given(spatial, spatial)
def test_the_sign_of_a_quaternion_does_not_change_the_step(a, b):
    assume(abs(lie.between(a, b)[6]) > 1e-9)
    negated = np.concatenate([b[:3], -b[3:]])
    assert_allclose(lie.local(a, negated), lie.local(a, b), rtol=0, atol=1e-9)


def assert_headings_in_range(a, b):
    for heading in (lie.compose(a, b)[2], lie.inverse(a)[2], lie.between(a, b)[2]):
        assert -PI <= heading < PI
    assert -PI <= lie.local(a, b)[2] < PI


@given(planar, planar)
def test_headings_lie_in_the_half_open_interval_from_minus_pi_to_pi(a, b):
    assert_headings_in_range(a, b)


@given(st.floats(min_value=-1e300, max_value=1e300))
def test_headings_of_many_turns_are_brought_into_the_interval_too(theta):
    assert_headings_in_range([0, 0, theta], [0, 0, 0.5])


def test_sines_and_cosines_are_right_to_two_units_in_the_last_index():
    rng = np.random.default_rng(1)
    quarters = np.arange(-70_000, 70_000) * (PI / 2)
    tiny = 10.0 ** -np.arange(300)
    theta = np.concatenate(
        [
            *(rng.uniform(-size, size, 20_000) for size in (1, 10, 1e3, 1e5, 1e6, 1e15)),
            *(np.nextafter(quarters, side) for side in (-np.inf, quarters, np.inf)),
            *(tiny, -tiny, [1e5, -1e5, 0.0]),
        ]
    )
    poses = np.column_stack([np.zeros((len(theta), 2)), theta])
    got = lie.compose(poses, [1, 0, 0])[:, :2]
    assert_allclose(got, np.column_stack([np.cos(theta), np.sin(theta)]), rtol=2**-51, atol=0)


@given(spatial, spatial)
def test_quaternions_come_out_at_unit_length_even_where_printing_rounded_them(a, b):
    a[3:] *= 1 + 1e-6
    for pose in (lie.compose(a, b), lie.inverse(a), lie.between(a, b), lie.retract(a, b[:6])):
        assert abs(np.linalg.norm(pose[3:]) - 1) < 1e-15


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ([1, 2, PI / 2], [1, 0, 0], [1, 3, PI / 2]),
        ([1, 2, PI / 2], [0, 1, PI / 2], [0, 2, -PI]),
        ([0, 0, PI], [0, 0, PI], [0, 0, 0]),
        ([3, 4, 0], [1, 1, PI], [4, 5, -PI]),
        ([1, 2, 3, *QUARTER_Z[3:]], [1, 0, 0, 0, 0, 0, 1], [1, 3, 3, *QUARTER_Z[3:]]),
        (QUARTER_X, [0, 1, 0, 0, 0, 0, 1], [0, 0, 1, *QUARTER_X[3:]]),
        (QUARTER_Z, QUARTER_Z, [0, 0, 0, 0, 0, 1, 0]),
        (QUARTER_X, QUARTER_Z, [0, 0, 0, 0.5, -0.5, 0.5, 0.5]),  # i k = -j
    ],
)
def test_compositions_by_hand(a, b, expected):
    assert_allclose(lie.compose(a, b), expected, atol=1e-15)


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        ([1, 2, PI / 2], [-2, 1, -PI / 2]),
        ([1, 2, -PI], [1, 2, -PI]),
        ([1, 2, 3, *QUARTER_Z[3:]], [-2, 1, -3, 0, 0, -H, H]),
    ],
)
def test_inverses_by_hand(pose, expected):
    assert_allclose(lie.inverse(pose), expected, atol=1e-15)


def test_between_by_hand():
    assert_allclose(lie.between([1, 1, PI / 2], [1, 3, PI]), [2, 0, PI / 2], atol=1e-15)


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        ([0, 0, 0], [1, 2, PI], [1, 2, -PI]),
        ([1, 1, PI / 2], [1, 3, 0], [2, 0, -PI / 2]),
        (lie.identity(3), [1, 2, 3, *QUARTER_Z[3:]], [1, 2, 3, 0, 0, H]),
        (lie.identity(3), [1, 2, 3, 0, 0, -H, -H], [1, 2, 3, 0, 0, H]),
        (QUARTER_Z, [1, 0, 0, 0, 0, 0, 1], [0, -1, 0, 0, 0, -H]),
    ],
)
def test_steps_by_hand(a, b, expected):
    assert_allclose(lie.local(a, b), expected, atol=1e-15)


def test_retract_turns_by_the_quaternion_of_which_it_gets_the_vector_part():
    assert_allclose(lie.retract(lie.identity(3), [1, 2, 3, 0.6, 0, 0]), [1, 2, 3, 0.6, 0, 0, 0.8])


def test_a_vector_part_longer_than_one_is_the_half_turn_about_it():
    assert_allclose(lie.retract(lie.identity(3), [0, 0, 0, 0, 3, 4]), [0, 0, 0, 0, 0.6, 0.8, 0])


@pytest.mark.parametrize(("dimension", "pose"), [(2, [0, 0, 0]), (3, [0, 0, 0, 0, 0, 0, 1])])
def test_the_identity_is_the_origin_without_rotation(dimension, pose):
    assert_array_equal(lie.identity(dimension), pose)


@pytest.mark.parametrize("operation", [lie.compose, lie.between, lie.local])
@pytest.mark.parametrize("size", [3, 7])
@pytest.mark.parametrize(
    ("first", "second", "together"),
    [
        ((), (), ()),
        ((), (5,), (5,)),
        ((4, 5), (), (4, 5)),
        ((4, 1), (1, 5), (4, 5)),
        ((0,), (), (0,)),
    ],
)
def test_leading_axes_broadcast(operation, size, first, second, together):
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(*first, size)), rng.normal(size=(*second, size))
    for pose in (a, b):
        pose[..., 3:] /= np.linalg.norm(pose[..., 3:], axis=-1, keepdims=True)
    result = operation(a, b)
    wide_a, wide_b = np.broadcast_to(a, (*together, size)), np.broadcast_to(b, (*together, size))
    assert result.shape[:-1] == together
    for index in np.ndindex(together):
        assert_array_equal(result[index], operation(wide_a[index], wide_b[index]))


@pytest.mark.parametrize("size", [3, 7])
def test_steps_broadcast_against_poses(size):
    pose = lie.identity(2 if size == 3 else 3)
    steps = np.random.default_rng(1).uniform(-0.5, 0.5, (4, 5, 3 if size == 3 else 6))
    moved = lie.retract(pose, steps)
    assert moved.shape == (4, 5, size)
    assert_array_equal(moved[2, 3], lie.retract(pose, steps[2, 3]))


def test_views_that_are_not_contiguous_are_read_in_their_own_order():
    table = np.arange(24.0).reshape(4, 6)[::-2, ::2]
    assert_array_equal(lie.inverse(table), lie.inverse(table.tolist()))


def test_the_arguments_are_left_as_they_are():
    a, b = np.array([1.0, 2, 7]), np.array([3.0, 4, -7])
    lie.compose(a, b)
    lie.retract(a, b)
    lie.inverse(a)
    assert_array_equal([a, b], [[1, 2, 7], [3, 4, -7]])


def test_a_heading_that_is_no_number_stays_none():
    assert np.isnan(lie.compose([0, 0, np.nan], [0, 0, 0])[2])
    assert np.isnan(lie.local([0, 0, 0], [0, 0, np.nan])[2])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: lie.compose([0, 0, 0], QUARTER_X),
            r"2D and in 3D cannot be combined, got shapes \(\d,\) and \(\d,\)",
        ),
        (
            lambda: lie.local(QUARTER_X, [0, 0, 0]),
            r"2D and in 3D cannot be combined, got shapes \(\d,\) and \(\d,\)",
        ),
        (lambda: lie.inverse([0, 0]), r"got \(2,\)"),
        (lambda: lie.inverse(1.0), r"got \(\)"),
        (lambda: lie.compose(np.zeros((0, 5)), np.zeros((0, 5))), r"got \(0, 5\)"),
        (lambda: lie.retract([0, 0, 0], np.zeros(6)), r"steps must have shape \(\.\.\., 3\)"),
        (lambda: lie.retract(QUARTER_X, np.zeros(3)), r"steps must have shape \(\.\.\., 6\)"),
        (lambda: lie.retract(QUARTER_X, 0.0), r"steps must have shape \(\.\.\., 6\)"),
        (
            lambda: lie.compose(np.zeros((2, 3)), np.zeros((3, 3))),
            r"\(2, 3\) and \(3, 3\) do not broadcast",
        ),
        (lambda: lie.retract(np.zeros((2, 3)), np.zeros((3, 3))), "do not broadcast"),
        (lambda: lie.identity(4), "dimension must be 2 or 3, got 4"),
        (lambda: lie.inverse("abc"), "poses must be numbers, got strings"),
        (lambda: lie.inverse([0, 0, 1j]), "poses must be numbers, got complex numbers"),
        (lambda: lie.inverse([[0, 0, 0], [0, 0]]), "poses must be numbers: row 1 is not as long"),
        (lambda: lie.retract([0, 0, 0], [0, None, 0]), "steps must be numbers, got an object"),
    ],
)
def test_shapes_that_fit_no_group_are_refused(call, message):
    with pytest.raises(GraphError, match=message):
        call()


@pytest.mark.parametrize("dimension", [2, 3])
def test_poses_become_matrices_and_back(dimension):
    poses = random_poses(dimension, 50, np.random.default_rng(4)).reshape(5, 10, -1)
    matrices = lie.to_matrices(poses)
    assert matrices.shape == (5, 10, dimension + 1, dimension + 1)
    back = lie.from_matrices(matrices)
    assert back.shape == poses.shape
    assert np.abs(lie.local(poses, back)).max() < 1e-14
    # The matrix of a product is the product of the matrices.
    a, b = matrices[0], matrices[1]
    assert np.allclose(lie.to_matrices(lie.compose(poses[0], poses[1])), a @ b, atol=1e-14)


def test_a_matrix_by_hand():
    assert lie.to_matrices((1, 2, np.pi / 2)) == pytest.approx(
        np.array([[0, -1, 1], [1, 0, 2], [0, 0, 1]]), abs=1e-15
    )


@pytest.mark.parametrize(
    "matrix",
    [np.diag([1, 1, 1, 2]), np.diag([1, 1, -1, 1]), np.diag([2, 1, 1, 1]), 2 * np.eye(3)],
)
def test_what_is_no_rigid_motion_is_refused(matrix):
    with pytest.raises(GraphError, match="matrix 0 is no rotation with a translation"):
        lie.from_matrices(matrix)


@pytest.mark.parametrize("shape", [(4,), (5, 5), (3, 4), ()])
def test_other_shapes_are_no_matrices(shape):
    with pytest.raises(GraphError, match="matrices must have shape"):
        lie.from_matrices(np.zeros(shape))

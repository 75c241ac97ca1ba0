"""Priors of parts of a map that grows, until they determine where the part lies in the world."""

from __future__ import annotations

import numpy as np

from masat import _core, lie
from masat.arrays import AnyArray, Flags, Floats, Ids, Indices
from masat.assembly import assemble
from masat.covariance import covariances
from masat.graph import PoseGraph
from masat.initializers.odometry import odometry
from masat.initializers.placing import placed_assembly
from masat.measurements.priors import Priors
from masat.optimizers import optimize

# Standard deviation of the rotation of a part, in radians, up to which its place is known well
# enough to go on from there by Gauss-Newton.
_MAX_ANGLE = 0.2
# Growth of the number of priors after which a part is tried again.
_GROWTH = 1.2
# Information of the relative poses of a part, as a multiple of that of its priors: it is moved as a
# whole.
_STIFFNESS = 1e3


def record_of_priors(dimension: int) -> np.dtype[np.void]:
    """Return the type of the rows in which priors of 2D or 3D are kept and saved."""
    dof = lie.DOF[dimension]
    return np.dtype(
        [
            ("number", np.int64),
            ("id", np.int64),
            ("node", np.int32),
            ("measurement", np.float64, (lie.POSE_SIZE[dimension],)),
            ("information", np.float64, (dof, dof)),
            ("rejected", np.bool_),
        ]
    )


class WaitingPriors:
    """Priors that are no part of the map yet, or were rejected when all was decided on.

    A part of the map that is not tied to the world lies in a frame of its own. Its priors wait
    until they determine the rigid motion of the part well enough. Then it is moved onto them, and
    they become part of the map. Up to a third of them may be wrong (`masat.alignment`).

    Parameters
    ----------
    dimension : int
        2 or 3.
    """

    def __init__(self, dimension: int) -> None:
        self._rows: AnyArray = np.zeros(0, record_of_priors(dimension))
        self._new = 0
        self._leaving: list[Ids] = []
        # How many priors each part had when it was tried last, by its fixed node.
        self._tried: dict[int, int] = {}

    @property
    def rows(self) -> AnyArray:
        """All of them."""
        return self._rows

    @property
    def waiting(self) -> Ids:
        """Numbers of those that wait, ascending."""
        return np.sort(self._rows["number"][~self._rows["rejected"]])

    @property
    def rejected(self) -> AnyArray:
        """Those that were rejected."""
        rows: AnyArray = self._rows[self._rows["rejected"]]
        return rows

    def with_rejected(self, rows: AnyArray) -> WaitingPriors:
        """Return the same priors with others as those that are rejected."""
        other = object.__new__(WaitingPriors)
        other.__dict__.update(self.__dict__)
        other._rows = np.concatenate([self._rows[~self._rows["rejected"]], rows])
        return other

    def withhold(self, core: _core.OnlineMap, numbers: Ids, nodes: Indices, priors: Priors) -> None:
        """Take back priors that were just added to the core."""
        core.remove_edges(numbers)
        new = np.zeros(len(numbers), self._rows.dtype)
        new["number"], new["id"], new["node"] = numbers, priors.ids, nodes
        new["measurement"], new["information"] = priors.measurements, priors.information
        self._rows = np.concatenate([self._rows, new])
        self._new += len(new)

    def restore(self, rows: AnyArray) -> None:
        """Take over the priors of a file."""
        self._rows = rows.copy()

    def forget_new(self) -> None:
        """Forget what the current step has added and removed."""
        self._rows = self._rows[: len(self._rows) - self._new]
        self._new = 0
        self._leaving.clear()

    def withheld(self, numbers: Ids) -> Flags:
        """Return which numbers are those of priors that wait."""
        return np.asarray(np.isin(numbers, self._rows["number"][self._staying]))

    def remove(self, numbers: Ids) -> None:
        """Remove some of them at the next `release`; other numbers are skipped."""
        self._leaving.append(numbers)

    @property
    def _staying(self) -> Flags:
        if not self._leaving:
            return np.ones(len(self._rows), np.bool_)
        return np.asarray(~np.isin(self._rows["number"], np.concatenate(self._leaving)))

    def release(self, core: _core.OnlineMap) -> bool:
        """Move parts onto the priors that determine them, and add these to the core.

        Returns whether anything waits for the core's next update.
        """
        self._new = 0
        if len(self._rows) == 0:
            self._leaving.clear()
            return False
        self._rows = self._rows[self._staying]
        self._leaving.clear()
        if self._rows["rejected"].all():
            return False
        roots = core.roots()
        root_of_each = np.where(self._rows["rejected"], -1, roots[self._rows["node"]])
        released, poses, moved = np.zeros(len(self._rows), np.bool_), core.poses(), False
        for root in np.unique(root_of_each[root_of_each >= 0]).tolist():
            mine = root_of_each == root
            if root == 0:
                released |= mine
            elif self._tie(poses, root, roots, self._rows[mine]):
                released |= mine
                moved = True
        if moved:
            core.start_from(poses[1:])
        rows, self._rows = self._rows[released], self._rows[~released]
        if len(rows):
            core.add_priors(
                np.array(rows["node"]),
                np.array(rows["measurement"]),
                np.array(rows["information"]),
                np.array(rows["number"]),
            )
        return len(rows) > 0

    def _tie(self, poses: Floats, root: int, roots: Indices, rows: AnyArray) -> bool:
        """Move the poses of a part of the map onto its priors, if they determine its place."""
        if len(rows) < _GROWTH * self._tried.get(root, 0):
            return False
        self._tried[root] = len(rows)
        motion = _motion(poses, rows)
        if motion is None:
            return False
        poses[roots == root] = lie.compose(motion, poses[roots == root])
        return True


def _motion(poses: Floats, rows: AnyArray) -> Floats | None:
    """Return the motion of a rigid part onto its priors, or None if they leave it open."""
    nodes, own = np.unique(rows["node"], return_inverse=True)
    there, count = poses[nodes], len(nodes)
    d = 2 if poses.shape[1] == 3 else 3
    weight = _STIFFNESS * float(np.einsum("kii->k", rows["information"]).max())
    extent = 1 + float(np.square(np.ptp(there[:, :d], axis=0)).sum())
    dof = rows["information"].shape[1]
    stiff = weight * np.diag([1.0] * d + [extent] * (dof - d))
    chain = np.column_stack([np.arange(count - 1), np.arange(1, count)])
    part = PoseGraph.from_arrays(
        chain,
        lie.between(there[:-1], there[1:]),
        np.tile(stiff, (count - 1, 1, 1)),
        ids=np.arange(count),
    ).with_priors(
        Priors(
            own.astype(np.int64),
            np.array(rows["measurement"]),
            np.array(rows["information"]),
        )
    )
    placed, _, undetermined = placed_assembly(assemble(part), odometry)
    if undetermined:
        return None
    assert placed.graph.poses is not None
    found = placed.graph.poses[placed.poses_at]
    result = optimize(placed.disassembled(placed.graph.poses))
    spread = np.linalg.eigvalsh(covariances(result.graph, [0])[0][d:, d:])[-1]
    # In 3D the covariance is that of half the angle.
    if np.sqrt(spread) * (1 if d == 2 else 2) > _MAX_ANGLE:
        return None
    return lie.compose(found[:1], lie.inverse(there[:1]))

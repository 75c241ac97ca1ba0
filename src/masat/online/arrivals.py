"""Loop closures of a map that grows, each judged when it arrives."""

from __future__ import annotations

from collections import defaultdict
from itertools import product
from typing import Any

import numpy as np

from masat import _core, lie
from masat.arrays import AnyArray, Flags, Floats, Ids, locked
from masat.neighbors import cycle_distances
from masat.online.trusted import TrustedEdges
from masat.quantiles import FAR_GATE, GATE
from masat.robust.closures import REACH
from masat.robust.growth import MIN_RATIO, ODDS_ALONE
from masat.robust.prediction import log_volume
from masat.robust.table import RELEASED

CLOSURES = np.dtype(
    [
        ("edge", np.int64),
        ("from", np.int64),
        ("to", np.int64),
        ("kept", np.bool_),
        ("distance", np.float64),
        ("log_ratio", np.float64),
        ("reason", "U60"),
    ]
)
# Growth of the map after which its extent is measured again.
_GROWTH = 1.05
_NEW, _REMOVED, _KEPT, _FAR, _OPEN, _APART, _OUTVOTED, _SINGULAR, _RELEASED = range(9)
_REASONS = np.array(
    [
        "not judged yet",
        "removed",
        "kept",
        "contradicts the map",
        "undecided: as likely false as true",
        "undecided: nothing trusted connects its ends",
        "rejected in view of all closures",
        "leaves a pose undetermined",
        RELEASED,
    ],
    "U60",
)
STATES = len(_REASONS)


def record_of(dimension: int) -> np.dtype[np.void]:
    """Return the type of the rows in which closures of 2D or 3D are kept and saved."""
    dof = lie.DOF[dimension]
    return np.dtype(
        [
            ("number", np.int64),
            ("ids", np.int64, (2,)),
            ("ends", np.int32, (2,)),
            ("measurement", np.float64, (lie.POSE_SIZE[dimension],)),
            ("information", np.float64, (dof, dof)),
            ("state", np.int8),
            ("distance", np.float64),
            ("log_ratio", np.float64),
        ]
    )


def is_kept(rows: AnyArray) -> Flags:
    """Return which closures are edges of the map, (c,)."""
    return np.asarray(rows["state"] == _KEPT)


class Arrivals:
    """The edges of a map that may be false, and what is thought of each.

    A closure is predicted from the map (`_core.OnlineMap.predict`) and believed if the measurement
    is within the gate and much likelier than a false closure would make it; less so if another
    closure of the same place, undecided until then, agrees with it. These are the rules by which
    `masat.robust.growth` decides, one closure at a time.

    Parameters
    ----------
    dimension : int
        2 or 3.
    """

    def __init__(self, dimension: int) -> None:
        self._dof = lie.DOF[dimension]
        self.trusted = TrustedEdges(dimension)
        self._rows: AnyArray = np.zeros(64, record_of(dimension))
        self._count = 0
        self._row_of: dict[int, int] = {}
        self._unjudged: list[int] = []
        # Rows that are to be removed, to be checked, or to be judged when their ends are connected.
        self._leaving: set[int] = set()
        self._unchecked: list[int] = []
        self._apart: list[int] = []
        # Undecided closures by the blocks of nodes in which their ends lie.
        self._blocks: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
        # How many are edges of the map, and how many are not.
        self._kept = self.doubted = 0
        # Logarithm of the volume that a false closure may be in, and the nodes that it is of.
        self._volume, self._nodes = 0.0, 0

    def __len__(self) -> int:
        return self._kept + self.doubted

    @property
    def rows(self) -> AnyArray:
        """All closures that were ever added, in the order of their numbers."""
        return self._rows[: self._count]

    @property
    def present(self) -> Flags:
        """Which of them have not been removed."""
        return np.asarray(self.rows["state"] != _REMOVED)

    @property
    def kept(self) -> Flags:
        """Which of them are edges of the map."""
        return is_kept(self.rows)

    def judged(self) -> AnyArray:
        """Return the closures that were there at the last update, as they were judged."""
        rows: AnyArray = self.rows[self.present & (self.rows["state"] != _NEW)]
        return rows

    def rejected(self) -> Ids:
        """Return the numbers of those that are no edges of the map."""
        return np.asarray(self.rows["number"][self.present & ~self.kept])

    def copy(self) -> Arrivals:
        """Return closures that can be decided upon without changing these."""
        other = object.__new__(Arrivals)
        other.__dict__.update(self.__dict__)
        other._rows, other._row_of = self._rows.copy(), self._row_of.copy()
        return other

    def table(self) -> AnyArray:
        """Return what `OnlineMap.closures` tells."""
        rows = self.rows[self.present]
        out = np.zeros(len(rows), CLOSURES)
        out["edge"] = rows["number"]
        out["from"], out["to"] = rows["ids"].T
        out["kept"] = rows["state"] == _KEPT
        out["distance"], out["log_ratio"] = rows["distance"], rows["log_ratio"]
        out["reason"] = _REASONS[rows["state"]]
        return locked(out)

    def withhold(
        self,
        core: _core.OnlineMap,
        numbers: Ids,
        ids: Ids,
        measurements: Floats,
        information: Floats,
        trusted: bool | None = None,
    ) -> None:
        """Take back edges just added to the core that are to be judged first.

        Parameters
        ----------
        core : OnlineMap
            The core's map; the edges wait for its next update.
        numbers, ids, measurements, information : ndarray
            The edges.
        trusted : bool, optional
            Whether all are trusted. Default: those with a node to which no trusted edge leads yet.
        """
        closures: list[int] = []
        for k, (a, b) in enumerate(ids.tolist()):
            first = not (self.trusted.reaches(a) and self.trusted.reaches(b))
            if first if trusted is None else trusted:
                newer = max(core.find(a), core.find(b))
                self.trusted.add(int(numbers[k]), (a, b), newer, information[k])
            else:
                closures.append(k)
        if not closures:
            return
        if len(closures) < len(ids):
            numbers, ids = numbers[closures], ids[closures]
            measurements, information = measurements[closures], information[closures]
        core.remove_edges(numbers)
        self._unjudged += self._append(core, numbers, ids, measurements, information, _NEW)

    def restore(self, core: _core.OnlineMap, contents: dict[str, Any], rows: AnyArray) -> None:
        """Take over the closures of a file, with the contents of the map that it holds."""
        self._make_room(len(rows))
        self._rows[: len(rows)] = rows
        self._row_of = dict(zip(rows["number"].tolist(), range(len(rows)), strict=True))
        self._count = len(rows)
        self._count_again()
        state = rows["state"]
        self._apart = np.flatnonzero(state == _APART).tolist()
        for row in np.flatnonzero(state == _OPEN).tolist():
            self._blocks[self._block(row)].append(row)
        for k in np.flatnonzero(~np.isin(contents["edge_numbers"], rows["number"])).tolist():
            a, b = contents["edges"][k].tolist()
            newer = max(core.find(a), core.find(b))
            number = int(contents["edge_numbers"][k])
            self.trusted.add(number, (a, b), newer, contents["information"][k])
        self.trusted.commit()

    def release(self, rows: dict[str, AnyArray], core: _core.OnlineMap) -> None:
        """Take edges that were trusted as closures that are not believed."""
        measured = rows["measurements"], rows["information"]
        self._append(core, rows["edge_numbers"], rows["edges"], *measured, _RELEASED)
        self._count_again()

    def _append(
        self,
        core: _core.OnlineMap,
        numbers: Ids,
        ids: Ids,
        measurements: Floats,
        information: Floats,
        state: int,
    ) -> range:
        """Append closures, and return their rows."""
        first, count = self._count, len(numbers)
        self._make_room(first + count)
        new = self._rows[first : first + count]
        new["number"], new["ids"], new["state"] = numbers, ids, state
        new["ends"] = np.reshape([*map(core.find, ids.ravel().tolist())], (-1, 2))
        new["measurement"], new["information"] = measurements, information
        new["distance"] = new["log_ratio"] = np.nan
        indices = range(first, first + count)
        self._row_of.update(zip(numbers.tolist(), indices, strict=True))
        self._count += count
        self.doubted += count
        return indices

    def _make_room(self, count: int) -> None:
        if count > len(self._rows):
            larger = np.zeros(2 * count, self._rows.dtype)
            larger[: self._count] = self._rows[: self._count]
            self._rows = larger

    def _count_again(self) -> None:
        self._kept = int(np.count_nonzero(self.kept))
        self.doubted = int(np.count_nonzero(self.present)) - self._kept

    def forget_new(self) -> None:
        """Forget what the current step has added and removed."""
        self._rows["state"][self._unjudged] = _REMOVED
        self.doubted -= len(self._unjudged)
        self._unjudged.clear()
        self._leaving.clear()
        self.trusted.forget()

    def commit(self) -> None:
        """Make what the current step has added and removed final."""
        for row in self._leaving:
            if self._rows["state"][row] == _KEPT:
                self._kept -= 1
            else:
                self.doubted -= 1
            self._rows["state"][row] = _REMOVED
        self._leaving.clear()
        self.trusted.commit()

    def edges(self, which: Flags) -> dict[str, AnyArray]:
        """Return closures, chosen by a mask, as the contents of a core's map name them."""
        rows = self.rows[which]
        return {
            "edge_numbers": rows["number"],
            "edges": rows["ids"],
            "measurements": rows["measurement"],
            "information": rows["information"],
        }

    def find(self, number: int) -> int:
        """Return the row of a closure that is not removed nor to be removed, or -1."""
        row = self._row_of.get(number, -1)
        gone = row < 0 or row in self._leaving or self._rows["state"][row] == _REMOVED
        return -1 if gone else row

    def withheld(self, numbers: Ids) -> Flags:
        """Return which numbers are those of closures that are no edges of the map."""
        rows = [self.find(number) for number in numbers.tolist()]
        return np.array([row >= 0 and self._rows["state"][row] != _KEPT for row in rows], np.bool_)

    def remove(self, numbers: Ids) -> None:
        """Remove edges at the next `commit`; numbers of nothing are skipped."""
        self._leaving.update(row for row in map(self.find, numbers.tolist()) if row >= 0)
        self.trusted.remove(numbers.tolist())

    def judge(self, core: _core.OnlineMap) -> AnyArray:
        """Judge the new closures, and return the rows of those that are now believed."""
        state = self._rows["state"]
        new = [row for row in self._unjudged if state[row] == _NEW]
        self._unjudged.clear()
        new += self._connected_now(core)
        if not new:
            return self._rows[:0]
        rows = np.array(new)
        believed = self._predicted(rows, core)
        self._apart += rows[state[rows] == _APART].tolist()
        undecided = rows[~believed & (state[rows] == _OPEN)]
        if len(undecided):
            supported = self._supported(undecided, core.poses())
            if len(supported):
                again = self._predicted(supported, core, MIN_RATIO)
                rows, believed = np.append(rows, supported), np.append(believed, again)
            for row in undecided.tolist():
                self._blocks[self._block(row)].append(row)
        if not believed.any():
            return self._rows[:0]
        chosen = np.unique(rows[believed])
        state[chosen] = _KEPT
        self._kept += len(chosen)
        self.doubted -= len(chosen)
        self._unchecked += chosen.tolist()
        believed_rows: AnyArray = self._rows[chosen]
        return believed_rows

    def drop_far(self, core: _core.OnlineMap) -> Ids:
        """Return the numbers of closures lately believed that the map contradicts after all."""
        if not self._unchecked:
            return np.empty(0, np.int64)
        rows = [row for row in self._unchecked if self._rows["state"][row] == _KEPT]
        self._unchecked.clear()
        numbers = self._rows["number"][rows]
        far = core.edge_chi2(numbers) > FAR_GATE[self._dof]
        self._reject(np.array(rows, np.int64)[far], _FAR)
        return np.asarray(numbers[far])

    def compare(self, core: _core.OnlineMap, believed: AnyArray) -> None:
        """Reject closures just believed that could not become edges of the map."""
        rows = [self._row_of[number] for number in believed["number"].tolist()]
        self._reject(
            np.array(
                [row for row in rows if not core.has_edge(int(self._rows["number"][row]))],
                np.int64,
            ),
            _SINGULAR,
        )

    def _reject(self, rows: Ids, state: int) -> None:
        if len(rows) == 0:
            return
        self._rows["state"][rows] = state
        self._count_again()

    def decide(self, kept: Flags) -> None:
        """Take over a decision on all closures, (c,); what was removed stays so."""
        state = self.rows["state"]
        state[~kept & (state == _KEPT)] = _OUTVOTED
        state[kept & self.present] = _KEPT
        self._count_again()

    def _connected_now(self, core: _core.OnlineMap) -> list[int]:
        """Return the closures whose ends nothing connected when they were judged."""
        self._apart = [row for row in self._apart if self._rows["state"][row] == _APART]
        if not self._apart:
            return []
        one, other = core.roots()[self._rows["ends"][self._apart]].T
        joined = (one == other).tolist()
        found = [row for row, now in zip(self._apart, joined, strict=True) if now]
        self._apart = [row for row, now in zip(self._apart, joined, strict=True) if not now]
        return found

    def _predicted(self, rows: Ids, core: _core.OnlineMap, needed: float | None = None) -> Flags:
        """Predict closures from the map, and return which are likely enough to be true."""
        chosen = self._rows[rows]
        # Rows of a table are not aligned: the core takes copies.
        distance, log_determinant = core.predict(
            np.array(chosen["ends"]),
            np.array(chosen["measurement"]),
            np.array(chosen["information"]),
        )
        ratio = self._log_volume(core) - (distance + log_determinant) / 2
        if needed is None:
            # The more closures there are, the more likely a false one fits by chance.
            needed = float(np.log(max(self.doubted, 1))) + ODDS_ALONE
        within = distance < GATE[self._dof]
        state = np.where(within, _OPEN, _FAR)
        if np.isnan(distance).any():
            one, other = core.roots()[chosen["ends"]].T
            state[one != other] = _APART
        self._rows["state"][rows] = state
        self._rows["distance"][rows], self._rows["log_ratio"][rows] = distance, ratio
        return np.asarray(within & (ratio > needed))

    def _supported(self, undecided: Ids, poses: Floats) -> Ids:
        """Return the undecided closures that agree with new ones of their place, and these."""
        pairs: list[tuple[int, int]] = []
        new = undecided.tolist()
        for k, row in enumerate(new):
            a, b = self._block(row)
            near = new[:k]
            for block in product((a - 1, a, a + 1), (b - 1, b, b + 1)):
                if block in self._blocks:
                    rows = self._blocks[block]
                    rows[:] = [other for other in rows if self._rows["state"][other] == _OPEN]
                    near = near + rows
            # One that was sent twice does not support itself.
            ends = self._rows["ends"][row].tolist()
            pairs += [(row, other) for other in near if self._rows["ends"][other].tolist() != ends]
        if not pairs:
            return np.empty(0, np.int64)
        members, local = np.unique(np.array(pairs), return_inverse=True)
        local = local.reshape(-1, 2)
        ends = self._rows["ends"][members].astype(np.int64)
        z = self._rows["measurement"][members].copy()
        backward = ends[:, 0] > ends[:, 1]
        z[backward] = lie.inverse(z[backward])
        ends = np.sort(ends, axis=1)
        one_place = (np.abs(ends[local[:, 0]] - ends[local[:, 1]]) <= REACH).all(axis=1)
        local = local[one_place]
        variances = np.einsum("kii->ki", np.linalg.inv(self._rows["information"][members]))
        along = self.trusted.variance_along(len(poses))
        agree = cycle_distances(local, ends, z, variances, poses, along) < GATE[self._dof]
        return np.asarray(members[np.unique(local[agree])])

    def _log_volume(self, core: _core.OnlineMap) -> float:
        if core.nodes() > _GROWTH * self._nodes:
            self._nodes, self._volume = core.nodes(), log_volume(core.poses()[~core.points()][1:])
        return self._volume

    def _block(self, row: int) -> tuple[int, int]:
        a, b = sorted(self._rows["ends"][row].tolist())
        return a // REACH, b // REACH

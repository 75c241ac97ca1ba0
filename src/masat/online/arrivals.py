"""Loop closures of a map that grows, each judged when it arrives."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np

from masat import _core, lie
from masat.arrays import AnyArray, Flags, Floats, Ids, locked
from masat.neighbors import cycle_distances
from masat.quantiles import FAR_GATE, GATE
from masat.robust.closures import REACH
from masat.robust.growth import MIN_RATIO, ODDS_ALONE
from masat.robust.prediction import log_volume

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
_NEW, _REMOVED, _KEPT, _FAR, _OPEN, _APART, _OUTVOTED = range(7)
_REASONS = np.array(
    [
        "not judged yet",
        "removed",
        "kept",
        "contradicts the map",
        "undecided: as likely false as true",
        "undecided: nothing trusted connects its ends",
        "rejected in view of all closures",
    ],
    "U60",
)


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
        self._dof = dof = lie.DOF[dimension]
        self._rows: AnyArray = np.zeros(64, record_of(dimension))
        self._count = 0
        self._row_of: dict[int, int] = {}
        self._unjudged: list[int] = []
        # Nodes that edges have reached, and those that the edges of this step are the first to.
        self._reached: set[int] = set()
        self._just_reached: list[int] = []
        # Undecided closures by the blocks of nodes in which their ends lie.
        self._places: defaultdict[tuple[int, int], list[int]] = defaultdict(list)
        # Of each trusted edge the newer node and the information, not yet summed up.
        self._trusted: list[tuple[int, Floats]] = []
        self._along: Floats = np.zeros((0, dof))
        self._kept = 0
        # Logarithm of the volume that a false closure may be in, and the nodes that it is of.
        self._volume, self._nodes = 0.0, 0

    def __len__(self) -> int:
        return self._count

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

    @property
    def doubted(self) -> int:
        """How many are not believed."""
        return self._count - self._kept

    def copy(self) -> Arrivals:
        """Return closures that can be decided upon without changing these."""
        other = object.__new__(Arrivals)
        other.__dict__.update(self.__dict__)
        other._rows = self._rows.copy()
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
            Whether all are trusted. Default: those that are the first of one of their nodes.
        """
        closures: list[int] = []
        for k, pair in enumerate(ids.tolist()):
            new = [i for i in pair if i not in self._reached]
            self._reached.update(new)
            self._just_reached += new
            if not (new if trusted is None else trusted):
                closures.append(k)
            else:
                self._trusted.append((max(map(core.find, pair)), information[k]))
        if not closures:
            return
        core.remove_edges(numbers[closures])
        ends = [[core.find(i) for i in pair] for pair in ids[closures].tolist()]
        self._add(
            number=numbers[closures],
            ids=ids[closures],
            ends=ends,
            measurement=measurements[closures],
            information=information[closures],
            state=_NEW,
            distance=np.nan,
            log_ratio=np.nan,
        )

    def restore(self, core: _core.OnlineMap, contents: dict[str, Any], rows: AnyArray) -> None:
        """Take over the closures of a file, with the contents of the map that it holds."""
        self._rows, self._count = rows.copy(), len(rows)
        self._kept = int(np.count_nonzero(self.kept))
        self._row_of = {number: row for row, number in enumerate(rows["number"].tolist())}
        self._reached = set(np.unique(np.append(contents["edges"], rows["ids"])).tolist())
        trusted = ~np.isin(contents["edge_numbers"], rows["number"])
        newer = core.find_all(contents["edges"][trusted].ravel()).reshape(-1, 2).max(axis=1)
        self._trusted = list(zip(newer.tolist(), contents["information"][trusted], strict=True))
        for row in np.flatnonzero(rows["state"] == _OPEN).tolist():
            self._places[self._place(row)].append(row)

    def _add(self, **columns: Any) -> None:
        first, self._count = self._count, self._count + len(columns["number"])
        if self._count > len(self._rows):
            larger = np.zeros(2 * self._count, self._rows.dtype)
            larger[:first] = self._rows[:first]
            self._rows = larger
        for name, values in columns.items():
            self._rows[name][first : self._count] = values
        rows = range(first, self._count)
        self._row_of.update(zip(columns["number"].tolist(), rows, strict=True))
        self._unjudged.extend(rows)

    def forget_new(self) -> None:
        """Forget what the current step has added."""
        self._rows["state"][self._unjudged] = _REMOVED
        self._unjudged.clear()
        self._reached.difference_update(self._just_reached)
        self._just_reached.clear()

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
        """Return the row of a closure that has not been removed, or -1."""
        row = self._row_of.get(number, -1)
        return row if row >= 0 and self._rows["state"][row] != _REMOVED else -1

    def withheld(self, numbers: Ids) -> Flags:
        """Return which numbers are those of closures that are no edges of the map."""
        rows = np.array([self.find(number) for number in numbers.tolist()], np.int64)
        return np.asarray((rows >= 0) & (self._rows["state"][rows] != _KEPT))

    def remove(self, numbers: Ids) -> None:
        """Remove closures; other numbers are passed over."""
        for row in map(self.find, numbers.tolist()):
            if row >= 0:
                self._kept -= int(self._rows["state"][row] == _KEPT)
                self._rows["state"][row] = _REMOVED

    def judge(self, core: _core.OnlineMap) -> AnyArray:
        """Judge the new closures, and return the rows of those that are now believed."""
        new = [row for row in self._unjudged if self._rows["state"][row] == _NEW]
        self._unjudged.clear()
        self._just_reached.clear()
        if not new:
            return self._rows[:0]
        rows = np.array(new)
        believed = self._predicted(rows, core)
        undecided = rows[~believed & (self._rows["state"][rows] == _OPEN)]
        if len(undecided):
            supported = self._supported(undecided, core.poses())
            if len(supported):
                again = self._predicted(supported, core, MIN_RATIO)
                rows, believed = np.append(rows, supported), np.append(believed, again)
            for row in undecided.tolist():
                self._places[self._place(row)].append(row)
        if not believed.any():
            return self._rows[:0]
        chosen = np.unique(rows[believed])
        self._rows["state"][chosen] = _KEPT
        self._kept += len(chosen)
        believed_rows: AnyArray = self._rows[chosen]
        return believed_rows

    def drop_far(self, core: _core.OnlineMap, believed: AnyArray) -> Ids:
        """Return the numbers of closures just believed that the map contradicts after all."""
        chi2 = core.edge_chi2(np.ascontiguousarray(believed["number"]))
        far = np.ascontiguousarray(believed["number"][chi2 > FAR_GATE[self._dof]])
        self.reject(far, _FAR)
        return far

    def reject(self, numbers: Ids, state: int = _OUTVOTED) -> None:
        """Note that closures are no edges of the map any more."""
        rows = [self._row_of[number] for number in numbers.tolist()]
        self._rows["state"][rows] = state
        self._kept -= len(rows)

    def decide(self, kept: Flags) -> None:
        """Take over a decision on all closures, (c,); what was removed stays so."""
        state = self.rows["state"]
        state[~kept & (state == _KEPT)] = _OUTVOTED
        state[kept & self.present] = _KEPT
        self._kept = int(np.count_nonzero(self.kept))

    def _predicted(self, rows: Ids, core: _core.OnlineMap, needed: float | None = None) -> Flags:
        """Predict closures from the map, and return which are likely enough to be true."""
        chosen = self._rows[rows]
        distance, log_determinant = core.predict(
            np.ascontiguousarray(chosen["ends"]),
            np.ascontiguousarray(chosen["measurement"]),
            np.ascontiguousarray(chosen["information"]),
        )
        ratio = self._log_volume(core) - (distance + log_determinant) / 2
        if needed is None:
            # The more closures there are, the more likely a false one fits by chance.
            needed = float(np.log(max(self.doubted, 1))) + ODDS_ALONE
        within = distance < GATE[self._dof]
        state = np.where(within, _OPEN, np.where(np.isnan(distance), _APART, _FAR))
        self._rows["state"][rows] = state
        self._rows["distance"][rows], self._rows["log_ratio"][rows] = distance, ratio
        return np.asarray(within & (ratio > needed))

    def _supported(self, undecided: Ids, poses: Floats) -> Ids:
        """Return the undecided closures that agree with new ones at their place, and these."""
        pairs: list[tuple[int, int]] = []
        new = undecided.tolist()
        for k, row in enumerate(new):
            a, b = self._place(row)
            near = new[:k]
            for i in (a - 1, a, a + 1):
                for j in (b - 1, b, b + 1):
                    near = near + self._places.get((i, j), [])
            pairs += [(row, other) for other in near if self._rows["state"][other] == _OPEN]
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
        along = self._variance_along(len(poses))
        agree = cycle_distances(local, ends, z, variances, poses, along) < GATE[self._dof]
        return np.asarray(members[np.unique(local[agree])])

    def _log_volume(self, core: _core.OnlineMap) -> float:
        if core.nodes() > _GROWTH * self._nodes:
            self._nodes, self._volume = core.nodes(), log_volume(core.poses())
        return self._volume

    def _place(self, row: int) -> tuple[int, int]:
        a, b = sorted(self._rows["ends"][row].tolist())
        return a // REACH, b // REACH

    def _variance_along(self, nodes: int) -> Floats:
        """Return the sums of the variances of the trusted edges up to each node, (n, dof)."""
        known = len(self._along)
        if known < nodes:
            steps = np.zeros((nodes, self._dof))
            if self._trusted:
                newer = np.array([each for each, _ in self._trusted])
                variances = np.linalg.inv(np.array([w for _, w in self._trusted]))
                # Nodes that could not be added are gone.
                there = newer < nodes
                every = np.einsum("kii->ki", variances[there])
                np.maximum.at(steps, newer[there], every)
            self._trusted.clear()
            begin = self._along[-1:] if known else np.zeros((1, self._dof))
            rest = begin + np.cumsum(steps[known:], axis=0)
            self._along = np.concatenate([self._along, rest])
        return self._along

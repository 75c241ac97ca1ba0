"""Priors and observations of a map that grows, until they determine what they measure."""

from __future__ import annotations

import numpy as np

from masat import _core, lie
from masat.arrays import AnyArray, Flags, Ids, Indices
from masat.online.parts import motion_of_part, positions_of_landmarks, undetermined_rows
from masat.online.sensor_rows import (
    add_to_core,
    ends_of,
    places,
    record_of_rows,
    rows_of,
    with_rows,
)
from masat.residuals import as_poses

# Growth of the number of measurements after which a part or a landmark is tried again.
_GROWTH = 1.2


class Waiting:
    """Priors and observations that are no part of the map yet, or were rejected.

    A part of the map that is not tied to the world lies in a frame of its own. Its priors wait
    until they determine the rigid motion of the part well enough. Then it is moved onto them, and
    they become part of the map. Up to a third of them may be wrong (`masat.alignment`). The same
    holds for observations of landmarks of another part. Observations of a landmark that none of
    them places by itself wait until together they do.

    Parameters
    ----------
    dimension : int
        2 or 3.
    """

    def __init__(self, dimension: int) -> None:
        self._dimension = dimension
        self._rows: AnyArray = np.zeros(0, record_of_rows(dimension))
        # What the current step has added to the core, and how many of the rows it has taken out.
        self._added: list[AnyArray] = []
        self._taken_out = 0
        self._leaving: list[Ids] = []
        # How many rows each part and landmark had when it was tried last, by indices of nodes.
        self._tried: dict[tuple[int, int], int] = {}
        # Indices of landmarks that have no position yet; replaced, never changed.
        self._hidden: Indices = np.zeros(0, np.int32)

    @property
    def rows(self) -> AnyArray:
        """All of them."""
        return self._rows

    @property
    def hidden(self) -> Indices:
        """Indices of landmarks that have no position yet."""
        return self._hidden

    def numbers(self, *, priors: bool, rejected: bool) -> Ids:
        """Return the numbers of priors or of observations that wait or were rejected, ascending."""
        chosen = (self._rows["is_prior"] == priors) & (self._rows["rejected"] == rejected)
        return np.sort(self._rows["number"][chosen])

    @property
    def rejected(self) -> AnyArray:
        """Those that were rejected."""
        rows: AnyArray = self._rows[self._rows["rejected"]]
        return rows

    def with_rejected(self, rows: AnyArray) -> Waiting:
        """Return the same rows with others as those that are rejected."""
        other = object.__new__(Waiting)
        other.__dict__.update(self.__dict__)
        other._rows = np.concatenate([self._rows[~self._rows["rejected"]], rows])
        return other

    def with_waiting(self, rows: AnyArray) -> Waiting:
        """Return the same rows and more that wait."""
        other = object.__new__(Waiting)
        other.__dict__.update(self.__dict__)
        other._rows = np.concatenate([self._rows, rows])
        return other

    def add(self, core: _core.OnlineMap, rows: AnyArray, new_points: Indices | None = None) -> Ids:
        """Add new rows to the core, and return their numbers.

        `new_points` are the landmarks that have no position until the next update.
        """
        rows["number"] = -1
        if new_points is not None and len(new_points):
            self._hidden = np.concatenate([self._hidden, new_points])
        rows["number"] = add_to_core(core, rows, places(rows))
        self._added.append(rows)
        return np.array(rows["number"])

    def restore(self, core: _core.OnlineMap, rows: AnyArray) -> None:
        """Take over the rows of a file."""
        self._rows = rows.copy()
        self._hide(core)

    def forget_new(self, core: _core.OnlineMap) -> None:
        """Forget what the current step has added and removed."""
        self._rows = self._rows[: len(self._rows) - self._taken_out]
        self._taken_out = 0
        self._added.clear()
        self._leaving.clear()
        self._hide(core)

    def withheld(self, numbers: Ids) -> Flags:
        """Return which numbers are those of rows that wait."""
        return np.asarray(np.isin(numbers, self._rows["number"][self._staying]))

    def remove(self, numbers: Ids) -> None:
        """Remove some of them at the end of the step; other numbers are skipped."""
        self._leaving.append(numbers)
        self._tried.clear()

    @property
    def _staying(self) -> Flags:
        if not self._leaving:
            return np.ones(len(self._rows), np.bool_)
        return np.asarray(~np.isin(self._rows["number"], np.concatenate(self._leaving)))

    def take_out_undetermined(self, core: _core.OnlineMap, removed: Ids) -> None:
        """Let rows wait again that determine nothing without some edges of the core."""
        contents = core.contents()
        for prefix, names in (
            ("edge_numbers", ("edges", "measurements", "information")),
            ("sensor_numbers", [name for name in contents if name.startswith("sensor_")]),
        ):
            keep = ~np.isin(contents[prefix], removed)
            contents |= {name: contents[name][keep] for name in {prefix, *names}}
        added = self._added_within_parts(core, removed)
        contents = with_rows(contents, np.concatenate([rows_of(contents), added]))
        taken = rows_of(contents)[undetermined_rows(contents)]
        if len(taken):
            core.remove_edges(np.array(taken["number"]))
            self._rows = np.concatenate([self._rows, taken])
            self._taken_out += len(taken)
            self._tried.clear()

    def _added_within_parts(self, core: _core.OnlineMap, removed: Ids) -> AnyArray:
        """Return the new rows that join nodes which are joined already."""
        if not self._added:
            return self._rows[:0]
        added = np.concatenate(self._added)
        added = added[~np.isin(added["number"], removed)]
        ends, roots = ends_of(added, core), core.roots()
        known = (ends < len(roots)).all(axis=1)
        one, other = roots[ends[known]].T
        within: AnyArray = added[known][one == other]
        return within

    def commit(self, core: _core.OnlineMap) -> None:
        """Keep what the core has left out of its last update, and drop what was removed."""
        if self._added:
            added = np.concatenate(self._added)
            left_out = np.isin(added["number"], core.left_out())
            self._rows = np.concatenate([self._rows, added[left_out]])
        if self._leaving:
            self._rows = self._rows[self._staying]
            self._leaving.clear()
        self._added.clear()
        self._taken_out = 0
        self._hide(core)

    def release(self, core: _core.OnlineMap) -> bool:
        """Add rows to the core that are determined now, for its next update.

        Returns whether there are any.
        """
        if len(self._rows) == 0:
            return False
        waiting = np.flatnonzero(~self._rows["rejected"])
        if len(waiting) == 0:
            return False
        rows = self._rows[waiting]
        ends, roots = ends_of(rows, core), core.roots()
        one, other = roots[ends].T
        to_lone = core.points()[other]
        may_place: Flags = places(rows) & to_lone
        ready = (one == other) | _with_first(ends[:, 1], one, may_place)
        open_ = to_lone & ~np.isin(ends[:, 1], ends[may_place, 1]) & ~rows["is_prior"]
        if open_.any():
            found = self._triangulated(core, rows, ends[:, 1], one, ends[:, 0], open_)
            ready, may_place = ready | found, may_place | found
        stays = not ready.any()
        if stays:
            ready = self._tied(core, rows, ends, roots, ~to_lone)
        if ready.any():
            self._rows = np.delete(self._rows, waiting[ready])
            self._added.append(rows[ready])
            add_to_core(core, rows[ready], None if stays else may_place[ready])
        return bool(ready.any())

    def take_back(self) -> None:
        """Let the rows wait again that `release` added, since the core's update failed."""
        self._rows = np.concatenate([self._rows, *self._added])
        self._added.clear()

    def _triangulated(
        self,
        core: _core.OnlineMap,
        rows: AnyArray,
        points: Indices,
        parts: Indices,
        seen_from: Indices,
        open_: Flags,
    ) -> Flags:
        """Place landmarks where several observations from one part determine them.

        Returns which rows are observations of these from that part.
        """
        out, open_points = np.zeros(len(rows), np.bool_), dict[int, list[Flags]]()
        for point, part in np.unique(np.stack([points, parts], 1)[open_], axis=0).tolist():
            mine = open_ & (points == point) & (parts == part)
            count = int(np.count_nonzero(mine))
            if count > 1 and count >= _GROWTH * self._tried.get((point, part), 0):
                self._tried[point, part] = count
                open_points.setdefault(point, []).append(mine)
        # All landmarks at the same time, each from one part after the other.
        while open_points:
            tried = {point: masks.pop(0) for point, masks in open_points.items()}
            every = np.logical_or.reduce(list(tried.values()))
            poses = core.poses()[seen_from[every]]
            positions, determined = positions_of_landmarks(rows[every], poses)
            at = np.searchsorted(np.unique(rows["node"][every]), core.ids()[list(tried)])
            for k, (point, mine) in zip(at.tolist(), tried.items(), strict=True):
                if determined[k]:
                    core.place_point(point, as_poses(positions[k : k + 1])[0])
                    out |= mine
                if determined[k] or not open_points[point]:
                    del open_points[point]
        return out

    def _tied(
        self,
        core: _core.OnlineMap,
        rows: AnyArray,
        ends: Indices,
        roots: Indices,
        is_tie: Flags,
    ) -> Flags:
        """Move a part of the map onto rows that join it to another or to the world.

        Returns which rows these are, if they determine its place. The other part is the older one.
        """
        parts = np.sort(roots[ends], axis=1)
        for older, newer in np.unique(parts[is_tie], axis=0).tolist():
            mine: Flags = is_tie & (parts == (older, newer)).all(axis=1)
            count = int(np.count_nonzero(mine))
            if count < _GROWTH * self._tried.get((older, newer), 0):
                continue
            self._tried[older, newer] = count
            poses, is_moved = core.poses(), roots == newer
            motion = motion_of_part(poses, rows[mine], ends[mine], is_moved)
            if motion is not None:
                poses[is_moved] = lie.compose(motion, poses[is_moved])
                core.start_from(poses[1:])
                return mine
        return np.zeros(len(rows), np.bool_)

    def _hide(self, core: _core.OnlineMap) -> None:
        """Note which landmarks have nothing but what waits, or have never had a position."""
        if len(self._rows) == 0 and len(self._hidden) == 0:
            return
        nodes = core.find_all(np.unique(self._rows["node"][~self._rows["rejected"]]))
        nodes = np.union1d(nodes[nodes > 0], self._hidden[self._hidden < core.nodes()])
        self._hidden = nodes[core.points()[core.roots()[nodes]]]


def _with_first(points: Indices, parts: Indices, may_place: Flags) -> Flags:
    """Tell which rows are of a landmark that some row places, and from the part that does first."""
    placed, first = np.unique(points[may_place], return_index=True)
    if len(placed) == 0:
        return np.zeros(len(points), np.bool_)
    at = np.searchsorted(placed, points).clip(max=len(placed) - 1)
    return np.asarray((placed[at] == points) & (parts[may_place][first][at] == parts))

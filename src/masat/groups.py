"""The members of groups, such as the edges of each node, without a search for each."""

from __future__ import annotations

import numpy as np

from masat.arrays import Ids, Indices


class Groups:
    """Indices by group.

    Parameters
    ----------
    labels : ndarray of int, (n,)
        The group of each index, from 0.
    count : int
        Number of groups.
    """

    def __init__(self, labels: Ids | Indices, count: int) -> None:
        self._members = np.argsort(labels, kind="stable")
        self._start = np.concatenate([[0], np.cumsum(np.bincount(labels, minlength=count))])

    def of(self, group: int) -> Ids:
        """Return the indices of one group, ascending."""
        members: Ids = self._members[self._start[group] : self._start[group + 1]]
        return members

    def of_all(self, groups: Ids) -> Ids:
        """Return the indices of several groups, one group after the other."""
        first = self._start[groups]
        sizes = self._start[groups + 1] - first
        begins = np.cumsum(sizes) - sizes
        within = np.arange(int(sizes.sum())) - np.repeat(begins, sizes)
        members: Ids = self._members[np.repeat(first, sizes) + within]
        return members

"""What one update of a map did."""

from __future__ import annotations

from typing import NamedTuple


class Update(NamedTuple):
    """What one update of an `OnlineMap` did.

    Attributes
    ----------
    chi2 : float
        Sum over the edges of e' W e after it, approximately: edges whose poses hardly moved are not
        evaluated again. `OnlineMap.chi2` is exact.
    refactored : int
        Nodes that were eliminated again.
    relinearized : int
        Nodes whose edges were linearized again.
    changed : int
        Nodes that moved, however little.
    passes : int
        How often the equations were solved.
    complete : bool
        Whether the tolerance was reached. If not, for lack of time, the next update goes on.
    turned : float
        The largest rotation of a pose that was there before, in radians.
    """

    chi2: float
    refactored: int
    relinearized: int
    changed: int
    passes: int
    complete: bool
    turned: float

    def followed_by(self, then: Update) -> Update:
        """Return what two updates did together."""
        return Update(
            then.chi2,
            self.refactored + then.refactored,
            self.relinearized + then.relinearized,
            max(self.changed, then.changed),
            self.passes + then.passes,
            then.complete,
            max(self.turned, then.turned),
        )

"""When a trial is given up."""

from __future__ import annotations

import numpy as np

from masat.arrays import Floats
from masat.optimality.splices import same_minimum
from masat.optimizers import Iteration

# How many times what a step took off may still be missing.
_NEXT_GAIN = 4.0


class StopIfHopeless:
    """Stops an optimizer where the steps that are left would not bring chi2 low enough.

    A step may gain less than it could while the region of trust adapts: half of what was expected
    before the step counts in its place. Near a minimum, where steps get much shorter, the next ones
    gain little more than the last one. Poses that are back home, as they were, stop it, too.
    """

    def __init__(self, low_enough: float, iterations: int, home: Floats | None = None) -> None:
        self._low_enough, self._left, self._last = low_enough, iterations, np.inf
        self._expected, self._length = 0.0, 0.0
        self._home, self._is_home = home, False

    def look(self, poses: Floats) -> None:
        """Look whether poses are back home."""
        self._is_home = self._home is not None and same_minimum(self._home, poses)

    def __call__(self, step: Iteration) -> bool:
        """Return whether to stop after an iteration."""
        missing = step.chi2 - self._low_enough
        gained, self._last = self._last - step.chi2, step.chi2
        self._expected = max(min(gained, missing), self._expected / 2)
        self._left -= 1
        is_near = step.step < self._length / 2 and missing > _NEXT_GAIN * gained
        self._length = step.step
        return self._is_home or is_near or missing > self._left * self._expected


class StopIfFar:
    """Stops an optimizer near a minimum after a step that gains little of what is missing.

    The steps get shorter there. `chi2` is that before the first one.
    """

    def __init__(self, low_enough: float, chi2: float) -> None:
        self._low_enough, self._last = low_enough, chi2

    def __call__(self, step: Iteration) -> bool:
        """Return whether to stop after an iteration."""
        gained, self._last = self._last - step.chi2, step.chi2
        return step.chi2 - self._low_enough > _NEXT_GAIN * gained

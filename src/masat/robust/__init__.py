"""Which loop closures, priors and observations to believe."""

from __future__ import annotations

from masat.robust.all_measurements import decide
from masat.robust.decision import Decision

__all__ = ["Decision", "decide"]

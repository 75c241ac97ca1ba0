"""Which loop closures to believe."""

from __future__ import annotations

from masat.robust.decision import Decision, decide

__all__ = ["Decision", "decide"]

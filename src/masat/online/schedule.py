"""When a map that grows is looked at as a whole."""

from __future__ import annotations

from dataclasses import dataclass

# Rotation of a pose, in radians, that may have led into another minimum, and the growth of the map
# from one review for that reason to the next. On public graphs no pose turns by more than 0.27 in a
# step; in simulated worlds that ended in a wrong minimum some turned by 0.5 and more.
_TURNED, _GROWTH = 0.3, 1.1
# Closures that are not believed, at least and as a multiple of those at the last review, that are
# worth one; less than that if it changed so large a fraction of all.
_DOUBTED, _MORE, _MORE_IF_WRONG, _WRONG = 200, 12.0, 1.5, 0.02
# Steps after which the outcome of a review is taken over, at least and as a fraction of the nodes.
_STEPS, _FRACTION = 20, 0.05


@dataclass
class Schedule:
    """What has happened since the last review.

    Attributes
    ----------
    steps : int
        Updates so far.
    turned : float
        The largest rotation of a pose in one update since the last review, in radians.
    nodes, doubted : int
        Nodes, and closures that were not believed, at the last review.
    more : float
        Multiple of the latter that is worth the next review.
    """

    steps: int = 0
    turned: float = 0.0
    nodes: int = 0
    doubted: int = 0
    more: float = _MORE

    def count(self, turned: float) -> None:
        """Note an update, and by how much it turned a pose."""
        self.steps += 1
        self.turned = max(self.turned, turned)

    @property
    def has_turned(self) -> bool:
        """Whether the map may have come into another minimum since the last review."""
        return self.turned > _TURNED

    def is_time(self, nodes: int, doubted: int) -> bool:
        """Whether a map of so many nodes and closures in doubt is to be reviewed."""
        if self.has_turned and nodes >= _GROWTH * self.nodes:
            return True
        return doubted >= max(_DOUBTED, self.more * self.doubted)

    def begin(self, nodes: int, doubted: int) -> int:
        """Note that a review begins, and return the step at which its outcome is taken over.

        That step is the same on fast and slow machines, and so is the map.
        """
        self.turned, self.nodes, self.doubted = 0.0, nodes, doubted
        return self.steps + max(_STEPS, int(_FRACTION * nodes))

    def end(self, changed: int, closures: int) -> None:
        """Note how many of the closures were believed no more, or are now."""
        self.more = _MORE_IF_WRONG if changed > _WRONG * closures else _MORE

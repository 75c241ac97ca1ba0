"""Pictures of pose graphs."""

from masat.plotting.evaluation import plot_evaluation
from masat.plotting.figures import plot
from masat.plotting.stages import before_and_after

__all__ = ["before_and_after", "plot", "plot_evaluation"]

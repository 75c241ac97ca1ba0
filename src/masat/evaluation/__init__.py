"""How far a map is from the truth: ATE and RPE."""

from masat.evaluation.errors import PoseErrors
from masat.evaluation.evaluate import Evaluation, evaluate

__all__ = ["Evaluation", "PoseErrors", "evaluate"]

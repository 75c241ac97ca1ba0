"""The back end of SLAM: read a pose graph, find what is wrong with it, and make a map of it.

>>> import masat
>>> graph = masat.read("graph.g2o")  # doctest: +SKIP
>>> result = masat.solve(graph)  # doctest: +SKIP
>>> masat.write(result.graph, "map.g2o")  # doctest: +SKIP
"""

from typing import Any

from masat.chain import sessions
from masat.comparison import Comparison, compare
from masat.covariance import covariances, landmark_covariances, relative_covariances
from masat.diagnostics import Diagnosis, diagnose
from masat.errors import (
    EvaluationError,
    FormatError,
    GraphError,
    InformationError,
    InitializationError,
    MasatError,
    MasatWarning,
    OptimizationError,
    PartitionError,
)
from masat.evaluation import Evaluation, PoseErrors, evaluate
from masat.formats import read, read_links, read_observations, write
from masat.geodesy import east_north_up
from masat.graph import PoseGraph
from masat.initializers import initialize
from masat.measurements import (
    Landmarks,
    Priors,
    altitudes,
    gps,
    headings,
    landmarks,
    pose_priors,
    range_bearing,
)
from masat.merging import merge
from masat.online import OnlineMap
from masat.optimality.certificate import Certificate, certify
from masat.optimizers import Iteration, Result, StopReason, optimize
from masat.parts import Partition, PartitionResult, partition
from masat.plotting import plot
from masat.solver import solve
from masat.viewing import view

__all__ = [
    "Certificate",
    "Comparison",
    "Diagnosis",
    "Evaluation",
    "EvaluationError",
    "FormatError",
    "GraphError",
    "InformationError",
    "InitializationError",
    "Iteration",
    "Landmarks",
    "MasatError",
    "MasatWarning",
    "OnlineMap",
    "OptimizationError",
    "Partition",
    "PartitionError",
    "PartitionResult",
    "PoseErrors",
    "PoseGraph",
    "Priors",
    "Result",
    "StopReason",
    "__version__",
    "altitudes",
    "certify",
    "compare",
    "covariances",
    "diagnose",
    "east_north_up",
    "evaluate",
    "gps",
    "headings",
    "initialize",
    "landmark_covariances",
    "landmarks",
    "merge",
    "optimize",
    "partition",
    "plot",
    "pose_priors",
    "range_bearing",
    "read",
    "read_links",
    "read_observations",
    "relative_covariances",
    "sessions",
    "solve",
    "view",
    "write",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        # Reading the metadata takes longer than most graphs.
        from importlib.metadata import version

        return version("masat")
    raise AttributeError(f"module 'masat' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__

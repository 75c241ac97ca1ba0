"""Pose-graph SLAM without a guess: read, diagnose, initialize, optimize, plot."""

from masat.covariance import covariances, relative_covariances
from masat.diagnostics import Diagnosis, diagnose
from masat.errors import (
    FormatError,
    GraphError,
    InformationError,
    InitializationError,
    MasatError,
    MasatWarning,
    OptimizationError,
)
from masat.formats import read, write
from masat.graph import PoseGraph
from masat.initializers import initialize
from masat.merging import merge
from masat.optimality.certificate import Certificate, certify
from masat.optimizers import Iteration, Result, StopReason, optimize
from masat.plotting import plot

__all__ = [
    "Certificate",
    "Diagnosis",
    "FormatError",
    "GraphError",
    "InformationError",
    "InitializationError",
    "Iteration",
    "MasatError",
    "MasatWarning",
    "OptimizationError",
    "PoseGraph",
    "Result",
    "StopReason",
    "certify",
    "covariances",
    "diagnose",
    "initialize",
    "merge",
    "optimize",
    "plot",
    "read",
    "relative_covariances",
    "write",
]

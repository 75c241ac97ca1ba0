"""What a graph holds besides its edges: priors on nodes, and landmarks with their observations."""

from masat.measurements.fit import check_landmarks, check_priors
from masat.measurements.landmarks import Landmarks, joined_landmarks, landmarks
from masat.measurements.priors import Priors, altitudes, gps, headings, joined, pose_priors
from masat.measurements.range_bearing import range_bearing
from masat.measurements.saved import arrays_of, saved_landmarks, saved_priors

__all__ = [
    "Landmarks",
    "Priors",
    "altitudes",
    "arrays_of",
    "check_landmarks",
    "check_priors",
    "gps",
    "headings",
    "joined",
    "joined_landmarks",
    "landmarks",
    "pose_priors",
    "range_bearing",
    "saved_landmarks",
    "saved_priors",
]

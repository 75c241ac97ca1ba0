"""Graphs that are cut into parts, to be solved on a cluster or one part after the other."""

from masat.parts.partition import Partition, partition
from masat.parts.solving import PartitionResult

__all__ = ["Partition", "PartitionResult", "partition"]

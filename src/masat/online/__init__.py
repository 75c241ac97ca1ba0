"""A map that grows while the robot drives."""

from masat.online.growing import OnlineMap
from masat.online.update import Update

__all__ = ["OnlineMap", "Update"]

"""A map that grows while the robot drives."""

from masat.online.growing import OnlineMap, Update

__all__ = ["OnlineMap", "Update"]

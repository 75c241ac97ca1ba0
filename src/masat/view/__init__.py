"""An interactive view of a map, as one HTML page."""

from masat.view.viewing import View, view

__all__ = ["View", "view"]

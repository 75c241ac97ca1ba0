"""An interactive view of a map, as one HTML page."""

from masat.viewing.explorer import View, view

__all__ = ["View", "view"]

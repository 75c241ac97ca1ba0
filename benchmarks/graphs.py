"""The graphs that are measured, and the smallest chi2 known of each."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import masat
from benchmarks.data import DATA
from masat.structure import Structure
from masat.worlds import city, perturb


@dataclass(frozen=True)
class Case:
    """A public graph.

    Attributes
    ----------
    name : str
        As in the tables.
    file : str
        Below the data folder.
    best : float
        The smallest chi2 known, as in tests/test_optimizers.py.
    """

    name: str
    file: str
    best: float

    def reached(self, chi2: float) -> bool:
        """Tell whether this is the best known minimum."""
        return chi2 <= self.best * (1 + 1e-6)

    @property
    def source(self) -> Path:
        """Where the original lies."""
        return DATA / self.file

    def plain(self, folder: Path) -> Path:
        """Return a g2o file that every solver reads: the original, or a copy without its oddities.

        Oddities are compression and indefinite information, in whose place comes the identity.
        """
        source = self.source
        if source.suffix == ".g2o" and self.name != "cubicle":
            return source
        target = folder / f"{self.name}.g2o"
        if not target.exists():
            masat.write(quietly_read(source), target)
        return target


def quietly_read(path: Path) -> masat.PoseGraph:
    """Read a graph whose oddities are known."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", masat.MasatWarning)
        return masat.read(path, indefinite="identity")


CASES = {
    case.name: case
    for case in (
        Case("M3500", "2d/input_M3500_g2o.g2o", 137.9129509),
        Case("city10000", "2d/city10000.g2o", 511.9851636),
        Case("10kHog-man", "2d/10kHog-man.txt.gz", 171545.4474),
        Case("ais2klinik", "2d/ais2klinik.g2o", 172.8155793),
        Case("kitti_00", "2d/kitti_00.g2o", 98.32201174),
        Case("intel", "2d/intel.g2o", 45.00469581),
        Case("sphere2500", "3d/sphere2500.g2o", 727.1496672),
        Case("torus3D", "3d/torus3D.g2o.gz", 14574.74644),
        Case("parking-garage", "3d/parking-garage.g2o", 1.23869058),
        Case("sphere_bignoise", "3d/sphere_bignoise_vertex3.g2o", 743862.7209),
        Case("cubicle", "3d/cubicle.g2o", 8.750614187),
    )
}


CITY = "City 100k"


def graph_of(name: str) -> masat.PoseGraph:
    """Return a public graph, or a simulated city of 100,000 poses, at MASAT's poses."""
    if name == CITY:
        graph = perturb(city(100_000, seed=1), [0.05, 0.05, 0.02], seed=1)
    else:
        graph = quietly_read(CASES[name].source)
    return masat.initialize(graph, "masat")


def unused(graph: masat.PoseGraph) -> masat.PoseGraph:
    """Return a copy that has computed nothing yet, as if it had just been read."""
    return replace(graph, structure=Structure(graph.ids, graph.edges, graph.fixed, graph.dof))

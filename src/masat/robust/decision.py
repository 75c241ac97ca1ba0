"""What a robust solve believes, and why."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from masat.arrays import AnyArray, Flags, Floats, Ids, locked
from masat.graph import PoseGraph
from masat.robust.scales import Scales

MEASUREMENTS = np.dtype(
    [
        ("kind", "U11"),
        ("row", np.int64),
        ("node", np.int64),
        ("landmark", np.int64),
        ("kept", np.bool_),
        ("chi2", np.float64),
        ("distance", np.float64),
        ("reason", "U60"),
    ]
)


class RunnerUp(NamedTuple):
    """Another hypothesis that is nearly as likely.

    Attributes
    ----------
    kept : ndarray of bool, (m,)
        The edges that it keeps.
    cost : float
        Its cost.
    """

    kept: Flags
    cost: float


@dataclass(frozen=True, eq=False, repr=False)
class Decision:
    """Which loop closures of a graph to believe.

    Attributes
    ----------
    kept : ndarray of bool, (m,)
        Which edges of the graph are kept: the trusted ones, unless they are released, and those
        closures that are believed.
    closures : structured ndarray, (c,)
        A row for each edge that was not trusted or is so no longer: `edge` (its index), `from`,
        `to`, `kept`, `chi2` (in the map, with the information given), `distance` (squared
        Mahalanobis distance from the prediction, with the information as it was judged; for
        closures far beyond the gate that of a map on the way, or of one that agrees with them),
        `log_ratio` (logarithm of the likelihood ratio against a false closure), both NaN for kept
        ones, `cluster` (closures of one place that agree; -1 where nothing was compared), `reason`.
    cost : float
        chi2 of the trusted edges and of the kept closures, with the information as it was judged,
        and the price of the rejected ones (`masat.robust.objective`).
    scales : Scales
        Estimates of the factors by which the covariances of the trusted edges and of the kept
        closures exceed what their information says. None where too few other edges check them.
    used : Scales
        The factors with which the closures were judged; 1 unless the information was far off.
    released : ndarray of int64
        Indices of trusted edges that all closures across them contradict, and that are not kept.
    runner_up : RunnerUp or None
        Another hypothesis, if its cost is not much higher.
    poses : ndarray, (n, 3) or (n, 7)
        The map of the decision, near its minimum.
    measurements : structured ndarray, (p + l,)
        A row for each prior and then each observation of a landmark: `kind` ("prior" or
        "observation"), `row` (its index among these), `node`, `landmark` (-1 for priors), `kept`,
        `chi2` (in the map), `distance` (squared Mahalanobis distance from what the kept
        measurements predict), `reason`.
    points : ndarray, (k, 2) or (k, 3), or None
        The landmarks of the map.
    from_start : bool
        Whether these poses come from the initial guess of all edges.
    notes : tuple of str
        What else the user should know.
    """

    kept: Flags
    closures: AnyArray
    cost: float
    scales: Scales
    used: Scales
    released: Ids
    runner_up: RunnerUp | None
    poses: Floats
    measurements: AnyArray = field(default_factory=lambda: locked(np.zeros(0, MEASUREMENTS)))
    points: Floats | None = None
    from_start: bool = False
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        believed = int(self.closures["kept"].sum())
        said = f"{believed} of {len(self.closures)} loop closures"
        if len(self.measurements):
            said += f", {int(self.measurements['kept'].sum())} of {len(self.measurements)} priors "
            said += "and observations"
        return f"Decision({said} kept)"

    @property
    def kept_priors(self) -> Flags:
        """Which priors are kept, (p,)."""
        return self._kept_of("prior")

    @property
    def kept_observations(self) -> Flags:
        """Which observations of landmarks are kept, (l,)."""
        return self._kept_of("observation")

    def _kept_of(self, kind: str) -> Flags:
        table = self.measurements
        return np.asarray(table["kept"][table["kind"] == kind])

    def believed(self, graph: PoseGraph) -> PoseGraph:
        """Return the graph of the decision without what is rejected."""
        out = graph.without_edges(~self.kept)
        if graph.priors is not None:
            rows = self.kept_priors
            out = out.with_priors(graph.priors.rows(rows) if rows.any() else None)
        if graph.landmarks is not None:
            out = out.with_landmarks(graph.landmarks.observed(self.kept_observations))
        return out

    def to_dict(self) -> dict[str, Any]:
        """Return what JSON says of a decision."""
        rejected = self.closures[~self.closures["kept"]]
        runner_up = self.runner_up
        return {
            "closures": len(self.closures),
            "kept": int(self.closures["kept"].sum()),
            "cost": self.cost,
            "scales": self.scales._asdict(),
            "used_scales": self.used._asdict(),
            "released": self.released.tolist(),
            "runner_up": runner_up
            and {
                "cost": runner_up.cost,
                "keeps": np.flatnonzero(runner_up.kept & ~self.kept).tolist(),
                "rejects": np.flatnonzero(self.kept & ~runner_up.kept).tolist(),
            },
            "rejected": [
                {
                    name: row[name].item()
                    for name in ("edge", "from", "to", "chi2", "cluster", "reason")
                }
                for row in rejected
            ],
            "rejected_measurements": [
                {
                    name: row[name].item()
                    for name in ("kind", "row", "node", "landmark", "chi2", "reason")
                }
                for row in self.measurements[~self.measurements["kept"]]
            ],
        }

"""What an optimization returns, and how it is saved."""

from __future__ import annotations

import io
import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from masat import measurements
from masat.arrays import AnyArray, Flags, Floats, Ids, locked
from masat.errors import FormatError, MasatError
from masat.files import DAMAGED, write_atomically
from masat.freedoms import degrees_of_freedom
from masat.graph import PoseGraph
from masat.optimizers.termination import Iteration, StopReason

if TYPE_CHECKING:
    from masat.optimality.certificate import Certificate
    from masat.robust.decision import Decision

_VERSION = 2
_WEIGHTS = ("weights", "prior_weights", "observation_weights")


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """The outcome of `masat.solve` or `masat.optimize`.

    Attributes
    ----------
    graph : PoseGraph
        The graph at the poses of the lowest chi2, or robust cost, of all iterations.
    method : str
        The optimizer.
    reason : StopReason
        Why it stopped.
    message : str
        The same in a sentence, with what to do if it did not converge.
    initial_chi2, chi2 : float
        Sum over the edges of e' W e, without a factor 1/2, at the initial guess and at `poses`.
    history : tuple of Iteration
        chi2 (with a loss, the robust cost that was minimized), step length, damping and time of
        each iteration.
    gauge : ndarray of int64
        Ids of the nodes that were not optimized: the fixed ones, and one gauge-fixed node of each
        component without any.
    seconds : float
        Wall time of the optimization, the analysis of the graph included.
    init : str or None
        The initial guess, if `masat.solve` made it.
    init_seconds : float
        Wall time of the initial guess.
    certificate : Certificate or None
        Whether the poses are the global optimum, if `masat.solve` was asked to certify them.
    loss : str or None
        Name of the loss; None if chi2 was minimized.
    robust_cost : float or None
        With a loss, the minimized cost: the sum of rho(e' W e) over the edges, and of e' W e itself
        over the trusted ones.
    weights : ndarray, (m,), or None
        With a loss, the weight of each edge at `poses`, from 0 for an edge that was ignored to 1.
    prior_weights, observation_weights : ndarray, (p,) and (l,), or None
        The same of the priors and of the observations of landmarks, if the graph has either.
    decision : Decision or None
        Which loop closures were believed and why, if `masat.solve` was asked to be robust. `graph`
        then holds the edges that were kept.
    """

    graph: PoseGraph
    method: str
    reason: StopReason
    message: str
    initial_chi2: float
    chi2: float
    history: tuple[Iteration, ...]
    gauge: Ids
    seconds: float
    init: str | None = None
    init_seconds: float = 0.0
    certificate: Certificate | None = None
    loss: str | None = None
    robust_cost: float | None = None
    weights: Floats | None = None
    prior_weights: Floats | None = None
    observation_weights: Floats | None = None
    decision: Decision | None = None

    def __post_init__(self) -> None:
        self.__dict__["gauge"] = locked(self.gauge)
        for name in _WEIGHTS:
            if getattr(self, name) is not None:
                self.__dict__[name] = locked(getattr(self, name))

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self.__post_init__()

    @property
    def poses(self) -> Floats:
        """The optimized poses, (n, 3) or (n, 7) in the order of `graph.ids`."""
        assert self.graph.poses is not None
        return self.graph.poses

    @property
    def kept(self) -> Flags | None:
        """Which edges of the graph given were kept, (m,), if the solve was robust."""
        return None if self.decision is None else self.decision.kept

    @property
    def closures(self) -> AnyArray | None:
        """The table of loop closures, if the solve was robust; see `masat.robust.Decision`."""
        return None if self.decision is None else self.decision.closures

    @property
    def converged(self) -> bool:
        """Whether the poses are a (local) minimum."""
        return self.reason.converged

    @property
    def iterations(self) -> int:
        """Number of iterations."""
        return len(self.history)

    @property
    def degrees_of_freedom(self) -> int:
        """Measured numbers less unknown ones that they determine."""
        return degrees_of_freedom(self.graph)

    @property
    def reduced_chi2(self) -> float | None:
        """chi2 over the degrees of freedom: about 1 where the information is right.

        None where nothing is measured twice.
        """
        degrees_of_freedom = self.degrees_of_freedom
        return self.chi2 / degrees_of_freedom if degrees_of_freedom > 0 else None

    def __repr__(self) -> str:
        return (
            f"Result({self.method}: chi2 {self.initial_chi2:.6g} -> {self.chi2:.6g} in "
            f"{self.iterations} iterations, {self.reason.name})"
        )

    def _repr_html_(self) -> str:
        from masat.display import result_html

        return result_html(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the result, graph and history included, to an .npz file, whole or not at all.

        A better graph that the certificate may hold is not saved.
        """
        graph = self.graph
        about = {
            "version": _VERSION,
            "method": self.method,
            "reason": self.reason.name,
            "message": self.message,
            "initial_chi2": self.initial_chi2,
            "chi2": self.chi2,
            "seconds": self.seconds,
            "init": self.init,
            "init_seconds": self.init_seconds,
            "certificate": self.certificate and self.certificate.to_dict(),
            "loss": self.loss,
            "robust_cost": self.robust_cost,
            "decision": self.decision
            and {
                "cost": self.decision.cost,
                "scales": self.decision.scales,
                "used": self.decision.used,
                "released": self.decision.released.tolist(),
                "runner_up_cost": self.decision.runner_up and self.decision.runner_up.cost,
            },
            "notes": graph.notes,
        }
        optional: dict[str, Any] = {
            "labels": graph.labels,
            "stamps": graph.stamps,
            **measurements.arrays_of(graph),
            **{name: getattr(self, name) for name in _WEIGHTS},
            "kept": self.kept,
            "closures": self.closures,
            "judged_measurements": self.decision and self.decision.measurements,
            "runner_up_kept": self.decision
            and self.decision.runner_up
            and self.decision.runner_up.kept,
        }
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer,
            about=np.array(json.dumps(about)),
            ids=graph.ids,
            poses=self.poses,
            edges=graph.edges,
            measurements=graph.measurements,
            information=graph.information,
            fixed=graph.fixed,
            history=np.array(self.history, np.float64).reshape(-1, len(Iteration._fields)),
            gauge=self.gauge,
            **{name: array for name, array in optional.items() if array is not None},
        )
        write_atomically(Path(path), buffer.getvalue())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Result:
        """Read a result that `save` wrote.

        Raises
        ------
        FormatError
            If the file holds something else.
        """
        path = Path(path)
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                about = json.loads(str(arrays["about"]))
                if about["version"] != _VERSION:
                    raise FormatError(f"a result of version {about['version']}", path)
                graph = PoseGraph.from_arrays(
                    arrays["edges"],
                    arrays["measurements"],
                    arrays["information"],
                    ids=arrays["ids"],
                    poses=arrays["poses"],
                    fixed=arrays["fixed"],
                    notes=about["notes"],
                    labels=arrays.get("labels"),
                    stamps=arrays.get("stamps"),
                    priors=measurements.saved_priors(arrays),
                    landmarks=measurements.saved_landmarks(arrays),
                ).with_root(arrays["gauge"])
                return cls(
                    graph=graph,
                    method=about["method"],
                    reason=StopReason[about["reason"]],
                    message=about["message"],
                    initial_chi2=about["initial_chi2"],
                    chi2=about["chi2"],
                    history=tuple(Iteration(*row) for row in arrays["history"].tolist()),
                    gauge=graph.gauge,
                    seconds=about["seconds"],
                    init=about["init"],
                    init_seconds=about["init_seconds"],
                    certificate=_certificate(about["certificate"]),
                    loss=about.get("loss"),
                    robust_cost=about.get("robust_cost"),
                    **{name: arrays.get(name) for name in _WEIGHTS},
                    decision=_decision(about.get("decision"), arrays),
                )
        except FormatError:
            raise
        except (*DAMAGED, MasatError) as error:
            raise FormatError(f"not a saved result: {error}", path) from None


def _certificate(saved: dict[str, Any] | None) -> Certificate | None:
    from masat.optimality.certificate import Certificate

    if saved is None:
        return None
    names = ("status", "message", "chi2", "bound", "optimum")
    known = {name: saved[name] for name in names}
    return Certificate(**known, better=None, caveat=saved.get("caveat"))


def _decision(saved: dict[str, Any] | None, arrays: Any) -> Decision | None:
    from masat.robust.decision import Decision, RunnerUp
    from masat.robust.scales import Scales

    if saved is None:
        return None
    cost = saved["runner_up_cost"]
    return Decision(
        kept=locked(arrays["kept"]),
        closures=locked(arrays["closures"]),
        cost=saved["cost"],
        scales=Scales(*saved["scales"]),
        used=Scales(*saved["used"]),
        released=locked(np.array(saved["released"], np.int64)),
        runner_up=None if cost is None else RunnerUp(locked(arrays["runner_up_kept"]), cost),
        poses=locked(arrays["poses"]),
        measurements=locked(arrays["judged_measurements"]),
    )

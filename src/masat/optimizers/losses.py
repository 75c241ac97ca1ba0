"""Losses: how the cost of an edge grows with its chi2, so that wrong edges have little weight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from masat._core import Loss as ScaledLoss
from masat._core import LossKind
from masat.arrays import Flags, Floats
from masat.errors import OptimizationError
from masat.graph import PoseGraph
from masat.quantiles import LOSS_GATE

EdgeLoss: TypeAlias = Callable[[Floats], tuple[Floats, Floats]]
"""From chi2 of the edges, (m,), to their costs rho and weights rho' = d rho / d chi2, (m,) each."""

NamedLoss: TypeAlias = tuple[str, float]
"""The name of a loss, and its scale."""

GNC_TLS = "gnc_tls"
"""Name of the truncated loss that `masat.optimizers.gnc` minimizes in stages."""


@dataclass(frozen=True)
class Loss:
    """A loss by name; `loss(chi2, scale)` returns rho and its derivative, the weight.

    With u = chi2 / scale^2:

    ============= ======================================== ========================= ==========
    name          rho / scale^2                            weight                    rho's limit
    ============= ======================================== ========================= ==========
    cauchy        log(1 + u)                               1 / (1 + u)               none
    geman_mcclure u / (1 + u)                              1 / (1 + u)^2             scale^2
    huber         u; from u = 1 on 2 sqrt(u) - 1           1; then 1 / sqrt(u)       none
    tukey         (1 - (1 - u)^3) / 3; from u = 1 on 1 / 3 (1 - u)^2; then 0         scale^2 / 3
    dcs           u; from u = 1 on 3 - 4 / (1 + u)         1; then 4 / (1 + u)^2     3 scale^2
    gnc_tls       u; from u = 1 on 1                       1; then 0                 scale^2
    ============= ======================================== ========================= ==========

    Where chi2 is small, rho is chi2 and the weight 1. The weight never grows with chi2. A loss
    without a limit lets a wrong edge bend the map a little; one with a limit has more local minima.

    Attributes
    ----------
    name : str
        The key in `LOSSES`.
    kind : LossKind
        The formula in the core.

    Notes
    -----
    Sources: cauchy, huber, tukey: Holland and Welsch, Robust regression using iteratively
    reweighted least-squares, 1977. geman_mcclure: Geman and McClure, Statistical methods for
    tomographic image reconstruction, 1987. dcs: Agarwal, Tipaldi, Spinello, Stachniss, Burgard,
    Robust map optimization using dynamic covariance scaling, ICRA 2013, scale^2 being its Phi, with
    the cost of MacTavish and Barfoot, At all costs, CRV 2015. gnc_tls: `masat.optimizers.gnc`.

    Examples
    --------
    >>> import numpy as np
    >>> rho, weight = LOSSES["cauchy"](np.array([0.0, 4.0]), scale=2.0)
    >>> weight
    array([1. , 0.5])
    """

    name: str
    kind: LossKind

    def __call__(self, chi2: Floats, scale: float = 1.0) -> tuple[Floats, Floats]:
        """Return rho and the weight of each chi2, (m,) each."""
        return ScaledLoss(self.kind, scale)(np.ascontiguousarray(chi2, np.float64))


LOSSES: dict[str, Loss] = {
    name: Loss(name, kind)
    for name, kind in (
        ("cauchy", LossKind.CAUCHY),
        ("geman_mcclure", LossKind.GEMAN_MCCLURE),
        ("huber", LossKind.HUBER),
        ("tukey", LossKind.TUKEY),
        ("dcs", LossKind.DCS),
        (GNC_TLS, LossKind.TRUNCATED),
    )
}
"""The losses of `masat.optimize`."""


@dataclass(frozen=True)
class RobustCost:
    """The robust cost of a graph: a loss at its scale, and the edges that keep their chi2.

    Attributes
    ----------
    name : str
        Name of the loss.
    loss : callable
        From chi2 to cost and weight. One of the core is applied in the core.
    scale : float or None
        Its scale; None if the loss is the user's own.
    trusted : ndarray of bool, (m,), or None
        The edges that keep the squared loss, weight 1.
    """

    name: str
    loss: EdgeLoss
    scale: float | None
    trusted: Flags | None

    def __call__(self, chi2: Floats) -> tuple[Floats, Floats]:
        """Return the cost and the weight of each edge, (m,) each.

        Raises
        ------
        OptimizationError
            If the user's own loss returns something else than finite costs and weights.
        """
        try:
            rho, weight = (np.array(a, np.float64) for a in self.loss(chi2))
        except (TypeError, ValueError) as error:
            raise OptimizationError(
                f"the loss {self.name} must return two arrays, costs and weights: {error}"
            ) from None
        if rho.shape != chi2.shape or weight.shape != chi2.shape:
            raise OptimizationError(
                f"the loss {self.name} must return one cost and one weight an edge, "
                f"{chi2.shape}, got {rho.shape} and {weight.shape}"
            )
        wrong = ~(np.isfinite(rho) & np.isfinite(weight) & (weight >= 0)) & np.isfinite(chi2)
        if wrong.any():
            k = int(wrong.argmax())
            raise OptimizationError(
                f"the loss {self.name} must return finite costs and weights of at least 0; "
                f"for chi2 {chi2[k]:.6g} it returned cost {rho[k]:.6g} and weight {weight[k]:.6g}"
            )
        if self.trusted is not None:
            rho[self.trusted], weight[self.trusted] = chi2[self.trusted], 1.0
        return rho, weight


def robust_cost(
    graph: PoseGraph, loss: object, scale: float | None = None, trusted: object = None
) -> RobustCost:
    """Return the robust cost that the arguments of `masat.optimize` describe.

    Raises
    ------
    OptimizationError
        If the loss is unknown, the scale not positive, or the mask of the wrong shape.
    """
    if isinstance(loss, str):
        if loss not in LOSSES:
            known = ", ".join(LOSSES)
            raise OptimizationError(f"unknown loss {loss!r}; known: {known}, or a function")
        loss = LOSSES[loss]
    mask = checked_mask(len(graph.edges), trusted)
    if isinstance(loss, Loss):
        scale = default_scale(graph.dof) if scale is None else checked_scale(scale)
        return RobustCost(loss.name, ScaledLoss(loss.kind, scale), scale, mask)
    if not callable(loss):
        raise OptimizationError(f"a loss is a name or a function of chi2, got {loss!r}")
    if scale is not None:
        raise OptimizationError("a function as loss has its scale inside: leave out scale")
    return RobustCost(getattr(loss, "__name__", type(loss).__name__), loss, None, mask)


def default_scale(dof: int) -> float:
    """Return the scale whose square is the chi2 that one good edge in 100 exceeds."""
    return float(np.sqrt(LOSS_GATE[dof]))


def checked_scale(scale: object) -> float:
    """Return the scale of a loss, if it is one."""
    try:
        value = float(scale)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise OptimizationError(f"the scale must be a number, got {scale!r}") from None
    # Squares of more extreme scales leave the range of a double.
    if not 1e-100 <= value <= 1e100:
        raise OptimizationError(
            f"the scale of a loss must be positive, in standard deviations, got {value}"
        )
    return value


def checked_mask(edges: int, trusted: object) -> Flags | None:
    """Return a mask of so many edges, (m,), if it is one."""
    if trusted is None:
        return None
    mask = np.asarray(trusted)
    if mask.dtype != np.bool_ or mask.shape != (edges,):
        raise OptimizationError(
            f"trusted must be a boolean mask with one entry an edge, ({edges},), got "
            f"{mask.dtype} {mask.shape}"
        )
    return np.ascontiguousarray(mask)

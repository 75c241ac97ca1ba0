"""The rigid motion that moves a map onto measured positions and rotations, in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from masat import _core, lie
from masat.arrays import Flags, Floats, Ids

# Random subsets from which a motion is computed. If a third of the positions is wrong, a subset of
# three is right with probability 8/27: all of 100 are wrong with less than 1e-15.
_SUBSETS = 100
# Fraction of the residuals, the smallest ones, that decide between motions.
_TRIMMED = 0.6
# Steps that take the motion of those residuals again, and how many candidates take all of them.
_FIRST_STEPS, _LAST_STEPS, _CANDIDATES = 2, 20, 5
# Residuals beyond this multiple of the median of the best motion do not count at the end.
_FAR = 3.0


@dataclass(frozen=True)
class Matches:
    """What is known of a map in its own frame and in another one.

    Attributes
    ----------
    positions, targets : ndarray, (p, d)
        The same points in the frame of the map and in the other one.
    position_weights : ndarray, (p,)
        Inverse variances in 1/m^2.
    rotations, target_rotations : ndarray, (r, d, d)
        The same rotations in both frames.
    rotation_weights : ndarray, (r,)
        Weights of their chordal distances.
    """

    positions: Floats
    targets: Floats
    position_weights: Floats
    rotations: Floats
    target_rotations: Floats
    rotation_weights: Floats

    def residuals(self, rotation: Floats, translation: Floats) -> Floats:
        """Return the weighted squares of all residuals, (p + r,)."""
        moved = self.positions @ rotation.T + translation
        turned = rotation @ self.rotations
        return np.concatenate(
            [
                self.position_weights * np.square(moved - self.targets).sum(axis=1),
                self.rotation_weights * np.square(turned - self.target_rotations).sum(axis=(1, 2)),
            ]
        )


def rigid_motion(matches: Matches) -> Floats:
    """Return the pose, (3,) or (7,), that maps a map onto what is known of it.

    Minimizes the weighted squares of the distances of the positions and of the rotations over those
    matches that agree: up to a third of them may be wrong by any amount, and the map may lie at any
    distance and heading from the other frame. What the matches do not determine is the identity.

    Sources: Umeyama, Least-squares estimation of transformation parameters between two point
    patterns, PAMI 1991; the search for those that agree: Rousseeuw and Van Driessen, Computing LTS
    regression for large data sets, Data Mining and Knowledge Discovery 2006.

    Parameters
    ----------
    matches : Matches
        At least one.

    Returns
    -------
    ndarray, (3,) or (7,)
    """
    p, d = matches.positions.shape
    count = p + len(matches.rotations)
    everything = np.ones(count, np.bool_)
    best = _motion(matches, everything)
    kept = int(np.ceil(_TRIMMED * count))
    if count > d + 1:
        start = _improved(matches, best, kept, _LAST_STEPS)
        found = [start, *(_improved(matches, m, kept, _FIRST_STEPS) for m in _trials(matches))]
        found.sort(key=lambda motion: _trimmed(matches, motion, kept))
        last = [_improved(matches, m, kept, _LAST_STEPS) for m in found[:_CANDIDATES]]
        best = min(last, key=lambda motion: _trimmed(matches, motion, kept))
        residuals = matches.residuals(*best)
        agreeing = residuals <= _FAR**2 * np.median(residuals)
        best = _motion(matches, agreeing)
    rotation, translation = best
    pose: Floats = _core.nearest_rotations(np.ascontiguousarray(rotation[None]))[0]
    pose[:d] = translation
    return pose


def _motion(matches: Matches, which: Flags) -> tuple[Floats, Floats]:
    """Return the rotation and translation that fit some matches best."""
    p, d = matches.positions.shape
    of_positions, of_rotations = which[:p], which[p:]
    a, b = matches.positions[of_positions], matches.targets[of_positions]
    w = matches.position_weights[of_positions]
    total = w.sum()
    center_a = w @ a / total if total > 0 else np.zeros(d)
    center_b = w @ b / total if total > 0 else np.zeros(d)
    product = np.einsum("k,ki,kj->ij", w, b - center_b, a - center_a)
    product += np.einsum(
        "k,kij,klj->il",
        matches.rotation_weights[of_rotations],
        matches.target_rotations[of_rotations],
        matches.rotations[of_rotations],
    )
    scale = np.abs(product).max()
    # What is not determined stays at the identity: it decides where the rest is indifferent.
    left, _, right = np.linalg.svd(product + 1e-12 * (scale or 1.0) * np.eye(d))
    flip = np.ones(d)
    flip[-1] = np.sign(np.linalg.det(left @ right)) or 1.0
    rotation: Floats = (left * flip) @ right
    return rotation, center_b - rotation @ center_a


def _trials(matches: Matches) -> list[tuple[Floats, Floats]]:
    """Return the motions of small random subsets, always the same ones."""
    p, d = matches.positions.shape
    count = p + len(matches.rotations)
    rng = np.random.default_rng(0)
    out = []
    for _ in range(_SUBSETS):
        which = np.zeros(count, np.bool_)
        if p >= d:
            which[rng.choice(p, d, replace=False)] = True
        elif p:
            which[rng.integers(p)] = True
        if count > p and p < d:
            which[p + rng.integers(count - p)] = True
        out.append(_motion(matches, which))
    return out


def _improved(
    matches: Matches, motion: tuple[Floats, Floats], kept: int, steps: int
) -> tuple[Floats, Floats]:
    """Return the motion of the smallest residuals, taken again and again."""
    before = np.inf
    for _ in range(steps):
        residuals = matches.residuals(*motion)
        smallest = np.argpartition(residuals, kept - 1)[:kept]
        sum_of_them = float(residuals[smallest].sum())
        if sum_of_them >= before * (1 - 1e-9):
            break
        before = sum_of_them
        which = np.zeros(len(residuals), np.bool_)
        which[smallest] = True
        motion = _motion(matches, which)
    return motion


def _trimmed(matches: Matches, motion: tuple[Floats, Floats], kept: int) -> float:
    return float(np.partition(matches.residuals(*motion), kept - 1)[:kept].sum())


def moved(poses: Floats, motion: Floats, which: Flags | Ids) -> Floats:
    """Return the poses, some of them moved by a rigid motion."""
    out = poses.copy()
    out[which] = lie.compose(motion, poses[which])
    return out

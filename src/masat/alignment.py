"""The rigid motion that moves a map onto measured positions and rotations, in closed form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from masat import _core
from masat.arrays import Flags, Floats

# Random subsets from which a motion is computed, in 2D and 3D. If a third of the positions is
# wrong, a subset of two is right with probability 4/9 and one of three with 8/27: all are wrong
# with less than 1e-8.
_SUBSETS = {2: 32, 3: 60}
# Random subsets from which an upward direction is computed where heights alone are known.
_HEIGHT_SUBSETS = 60
# Fraction of the residuals, the smallest ones, that decide between motions.
_TRIMMED = 0.6
# Steps that take the motion of those residuals again, and how many candidates take all of them.
_FIRST_STEPS, _LAST_STEPS, _CANDIDATES = 2, 20, 5
# The search uses this many matches at most; those that agree are then found among all.
_MAX_SEARCHED = 60
# A step that lowers the sum of those residuals by a smaller fraction is the last one.
_LEAST_DECREASE = 0.01
# Residuals beyond this multiple of the median of the best motion do not count. The search for it
# is left out where none is: of 1000 Gaussian residuals in 2D the largest is 3.2 times the median.
_FAR = 3.3


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

    def __len__(self) -> int:
        return len(self.positions) + len(self.rotations)

    def sample(self, count: int) -> Matches:
        """Return at most so many matches chosen at random, always the same ones."""
        if len(self) <= count:
            return self
        p = len(self.positions)
        chosen = np.sort(np.random.default_rng(0).choice(len(self), count, replace=False))
        a, b = chosen[chosen < p], chosen[chosen >= p] - p
        return Matches(
            self.positions[a],
            self.targets[a],
            self.position_weights[a],
            self.rotations[b],
            self.target_rotations[b],
            self.rotation_weights[b],
        )

    def residuals(self, motions: Motions) -> Floats:
        """Return the weighted squares of all residuals at some motions, (s, p + r)."""
        rotation, translation = motions
        distance = np.zeros((len(rotation), len(self.positions)))
        for k in range(rotation.shape[1]):
            off = rotation[:, k] @ self.positions.T + translation[:, k, None] - self.targets[:, k]
            distance += off * off
        of_positions = self.position_weights * distance
        if len(self.rotations) == 0:
            return of_positions
        turned = rotation[:, None] @ self.rotations - self.target_rotations
        of_rotations = self.rotation_weights * np.square(turned).sum(axis=(2, 3))
        return np.concatenate([of_positions, of_rotations], axis=1)


class Motions(NamedTuple):
    """Rigid motions: rotations, (s, d, d), and translations, (s, d)."""

    rotation: Floats
    translation: Floats


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
    d = matches.positions.shape[1]
    which = np.ones((1, len(matches)), np.bool_)
    if len(matches) > d + 1:
        which = _agreeing(matches, _searched(matches.sample(_MAX_SEARCHED)))
    best = _motions(matches, which)
    pose: Floats = _core.nearest_rotations(np.ascontiguousarray(best.rotation))[0]
    pose[:d] = best.translation[0]
    return pose


def _searched(matches: Matches) -> Motions:
    """Return the motion whose smallest residuals are smallest."""
    kept = int(np.ceil(_TRIMMED * len(matches)))
    first = _motions(matches, np.ones((1, len(matches)), np.bool_))
    first = _improved(matches, first, kept, _LAST_STEPS)
    if _agreeing(matches, first).all():
        return first
    found = _improved(matches, _trials(matches), kept, _FIRST_STEPS)
    order = np.argsort(_trimmed(matches, found, kept), kind="stable")[:_CANDIDATES]
    last = _improved(matches, Motions(*(a[order] for a in found)), kept, _LAST_STEPS)
    both = Motions(*(np.concatenate(pair) for pair in zip(first, last, strict=True)))
    lowest = int(np.argmin(_trimmed(matches, both, kept)))
    return Motions(*(a[lowest : lowest + 1] for a in both))


def _agreeing(matches: Matches, motions: Motions) -> Flags:
    """Return which residuals, (s, p + r), are not far beyond the median."""
    residuals = matches.residuals(motions)
    # Without noise all residuals are rounding.
    floor = 1e-24 * (1 + np.abs(matches.targets).max(initial=0.0)) ** 2
    weights = np.concatenate([matches.position_weights, matches.rotation_weights])
    limit = _FAR**2 * np.median(residuals, axis=1, keepdims=True)
    return np.asarray(residuals <= np.maximum(limit, floor * weights))


def _motions(matches: Matches, which: Flags) -> Motions:
    """Return the motion that fits some matches best, for each row of a mask, (s, p + r)."""
    p, d = matches.positions.shape
    a, b = matches.positions, matches.targets
    w = np.where(which[:, :p], matches.position_weights, 0.0)
    total = w.sum(axis=1, keepdims=True)
    total[total == 0] = 1.0
    # About their middle, so that little is lost where coordinates are large.
    middle_a = a.mean(axis=0) if p else np.zeros(d)
    middle_b = b.mean(axis=0) if p else np.zeros(d)
    a, b = a - middle_a, b - middle_b
    center_a, center_b = w @ a / total, w @ b / total
    pairs = (b[:, :, None] * a[:, None]).reshape(p, d * d)
    product = (w @ pairs).reshape(-1, d, d)
    product -= total[..., None] * center_b[:, :, None] * center_a[:, None]
    if len(matches.rotations):
        turns = matches.target_rotations @ matches.rotations.transpose(0, 2, 1)
        of_rotations = np.where(which[:, p:], matches.rotation_weights, 0.0)
        product += (of_rotations @ turns.reshape(-1, d * d)).reshape(-1, d, d)
    # What is not determined stays at the identity: it decides where the rest is indifferent.
    scale = np.abs(product).max(axis=(1, 2), keepdims=True)
    rotation = _nearest_rotations(product + 1e-12 * np.where(scale > 0, scale, 1.0) * np.eye(d))
    moved_middle = np.einsum("sij,sj->si", rotation, center_a + middle_a)
    return Motions(rotation, center_b + middle_b - moved_middle)


def _nearest_rotations(matrices: Floats) -> Floats:
    """Return the rotations R of the largest tr(R' M), (s, d, d)."""
    if matrices.shape[1] == 2:
        x = matrices[:, 0, 0] + matrices[:, 1, 1]
        y = matrices[:, 1, 0] - matrices[:, 0, 1]
        angle = np.arctan2(y, x)
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, -s], [s, c]]).transpose(2, 0, 1)
    left, _, right = np.linalg.svd(matrices)
    mirrored = np.linalg.det(left @ right) < 0
    left[mirrored, :, -1] *= -1
    rotations: Floats = left @ right
    return rotations


def _trials(matches: Matches) -> Motions:
    """Return the motions of small random subsets, always the same ones."""
    p, d = matches.positions.shape
    r = len(matches.rotations)
    rng = np.random.default_rng(0)
    count = _SUBSETS[d]
    which = np.zeros((count, p + r), np.bool_)
    every = np.arange(count)
    if p:
        for _ in range(d if p >= d else 1):
            which[every, rng.integers(p, size=count)] = True
    if r and p < d:
        which[every, p + rng.integers(r, size=count)] = True
    return _motions(matches, which)


def _improved(matches: Matches, motions: Motions, kept: int, steps: int) -> Motions:
    """Return the motions of the smallest residuals, taken again and again."""
    before = np.inf
    for _ in range(steps):
        residuals = matches.residuals(motions)
        smallest = np.partition(residuals, kept - 1, axis=1)[:, :kept]
        now = float(smallest.sum())
        if now >= before * (1 - _LEAST_DECREASE):
            break
        before = now
        motions = _motions(matches, residuals <= smallest[:, -1:])
    return motions


def _trimmed(matches: Matches, motions: Motions, kept: int) -> Floats:
    """Return the sum of the smallest residuals of each motion, (s,)."""
    smallest: Floats = np.partition(matches.residuals(motions), kept - 1, axis=1)[:, :kept]
    return np.asarray(smallest.sum(axis=1))


def leveling_motion(positions: Floats, axis: Floats, heights: Floats, weights: Floats) -> Floats:
    """Return the pose, (3,) or (7,), that moves positions to their measured heights.

    Minimizes the weighted squares of the differences over the heights that agree: up to a third of
    them may be wrong. The rotation is the smallest one that levels the map.

    Parameters
    ----------
    positions : ndarray, (p, d)
        In the frame of the map.
    axis : ndarray, (d,)
        Unit vector in the other frame along which heights were measured.
    heights : ndarray, (p,)
        In meters.
    weights : ndarray, (p,)
        Inverse variances in 1/m^2.
    """
    d = positions.shape[1]
    best, which = (np.inf, axis, 0.0), np.ones(len(heights), np.bool_)
    kept = int(np.ceil(_TRIMMED * len(heights)))
    rng = np.random.default_rng(0)
    for trial in range(_HEIGHT_SUBSETS if len(heights) > d + 1 else 1):
        if trial > 0:
            which = np.zeros(len(heights), np.bool_)
            which[rng.integers(len(heights), size=d + 1)] = True
        for _ in range(_FIRST_STEPS + 1):
            up, shift = _up(positions, heights, np.where(which, weights, 0.0), axis)
            residuals = weights * np.square(positions @ up + shift - heights)
            smallest = np.partition(residuals, kept - 1)[:kept]
            which = residuals <= smallest[-1]
        if smallest.sum() < best[0]:
            best = (float(smallest.sum()), up, shift)
    _, up, shift = best
    residuals = weights * np.square(positions @ up + shift - heights)
    agreeing = residuals <= max(_FAR**2 * float(np.median(residuals)), 1e-24)
    up, shift = _up(positions, heights, np.where(agreeing, weights, 0.0), axis)
    # Half turns about `up` and about the axis halfway make the smallest rotation to the axis.
    half = up + axis
    if half @ half < 1e-12:
        half = np.eye(d)[int(np.argmin(np.abs(axis)))]
        half = half - (half @ axis) * axis
    rotation = (2 * np.outer(half, half) / (half @ half) - np.eye(d)) @ (
        2 * np.outer(up, up) - np.eye(d)
    )
    pose: Floats = _core.nearest_rotations(np.ascontiguousarray(rotation[None]))[0]
    pose[:d] = shift * axis
    return pose


def _up(positions: Floats, heights: Floats, weights: Floats, axis: Floats) -> tuple[Floats, float]:
    """Return the unit vector a and the shift c that minimize the weighted squares of a p + c - h.

    Least squares on a sphere: Forsythe and Golub, On the stationary values of a second-degree
    polynomial on the unit sphere, 1965. What the heights leave open is as near the axis as it can.
    """
    total = weights.sum()
    middle, level = weights @ positions / total, float(weights @ heights / total)
    p, h = positions - middle, heights - level
    values, vectors = np.linalg.eigh((p * weights[:, None]).T @ p)
    b = vectors.T @ ((p * weights[:, None]).T @ h)
    # What is not determined comes from the axis.
    b += 1e-9 * max(values[-1], 1e-300) * (vectors.T @ axis)
    size = float(np.sqrt(b @ b))
    low, high = -values[0], -values[0] + size
    for _ in range(100):
        guess = (low + high) / 2
        if np.square(b / np.maximum(values + guess, 1e-300)).sum() > 1:
            low = guess
        else:
            high = guess
    a = b / np.maximum(values + high, 1e-300)
    up = vectors @ (a / np.linalg.norm(a))
    return up, level - float(middle @ up)

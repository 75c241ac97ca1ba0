"""A robot with wheels and a laser scanner drives around a building and maps it.

    python examples/simulated_robot.py [--laps N] [--seed N] [--picture map.png]

It has what a front end has: odometry that drifts, scans, candidates for loop closures that the
covariances of the map propose, ICP that matches two scans, and a test of each match against what
the map predicts. The back end is `masat.OnlineMap`.
"""

from __future__ import annotations

import argparse

import numpy as np

import masat
from masat import lie

WAY = np.array([(4, 2), (20, 2), (22, 4), (22, 12), (20, 14), (4, 14), (2, 12), (2, 4), (4, 2)])
STEP = 0.5  # meters between two scans
ODOMETRY_SIGMAS = np.array([0.03, 0.02, 0.015])  # of a step: meters, meters, radians
BEAMS, MAX_RANGE, RANGE_SIGMA = 180, 8.0, 0.02
# The points of one wall are off together where a beam meets an edge: they say less than as many
# independent ones would.
MATCH_SIGMA = 0.2
MIN_GAP = 20  # scans between the two ends of a loop closure
MAX_DISTANCE = 1.5  # meters between them: from farther apart two scans see different walls
MIN_OVERLAP, MAX_RESIDUAL = 0.7, 0.05  # of a match: fraction of the points, meters
GATE = 16.27  # 99.9 % quantile of the chi-squared distribution with 3 degrees of freedom


def way(laps: float) -> np.ndarray:
    """Return the true poses: laps in the middle of the corridor."""
    known = np.r_[0, np.cumsum(np.linalg.norm(np.diff(WAY, axis=0), axis=1))]
    at = np.arange(0, laps * known[-1], STEP) % known[-1]
    xy = np.column_stack([np.interp(at, known, WAY[:, k]) for k in range(2)])
    ahead = np.diff(xy, axis=0, append=2 * xy[-1:] - xy[-2:-1])
    return np.column_stack([xy, np.arctan2(ahead[:, 1], ahead[:, 0])])


def building(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return both ends of each wall: a corridor around a block, and boxes beside the way."""

    def box(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
        return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])

    boxes, free = [box(0, 0, 24, 16), box(4, 4, 20, 12)], way(1)[:, :2]
    for _ in range(60):
        size, center = random.uniform(0.4, 1.2, 2), random.uniform((0, 0), (24, 16))
        if np.linalg.norm(free - center, axis=1).min() > 1.4:
            boxes.append(box(*(center - size / 2), *(center + size / 2)))
    return np.concatenate(boxes), np.concatenate([np.roll(b, -1, axis=0) for b in boxes])


def scan(
    walls: tuple[np.ndarray, np.ndarray], pose: np.ndarray, random: np.random.Generator
) -> np.ndarray:
    """Return the points, (k, 2), that the beams hit, in the frame of the robot."""
    angles = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
    x, y = np.cos(angles + pose[2])[:, None], np.sin(angles + pose[2])[:, None]
    (wx, wy), (bx, by) = (walls[1] - walls[0]).T, (walls[0] - pose[:2]).T
    with np.errstate(divide="ignore", invalid="ignore"):
        ranges = (bx * wy - by * wx) / (x * wy - y * wx)
        along = (bx * y - by * x) / (x * wy - y * wx)
    nearest = np.where((ranges > 0) & (along >= 0) & (along <= 1), ranges, np.inf).min(axis=1)
    angles, nearest = angles[nearest < MAX_RANGE], nearest[nearest < MAX_RANGE]
    nearest = nearest + RANGE_SIGMA * random.normal(size=len(nearest))
    return nearest[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])


def moved(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return points of a frame with a pose in the frame of the pose."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([(c, s), (-s, c)]) + pose[:2]


def match(
    old: np.ndarray, new: np.ndarray, guess: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the pose of a scan in the frame of another and its information, or None.

    ICP that minimizes the distances of points to lines: Chen and Medioni, Object modelling by
    registration of multiple range images, Image and Vision Computing 1992.
    """
    along = np.roll(old, -1, axis=0) - np.roll(old, 1, axis=0)
    all_normals = np.column_stack([-along[:, 1], along[:, 0]])
    all_normals /= np.linalg.norm(along, axis=1, keepdims=True)
    pose = guess
    for iteration in range(25):
        points = moved(new, pose)
        squared = (points**2).sum(axis=1)[:, None] - 2 * points @ old.T + (old**2).sum(axis=1)
        nearest = squared.argmin(axis=1)
        used = squared.min(axis=1) < (1.0 if iteration < 10 else 0.2) ** 2
        if used.mean() < 0.3:
            return None
        points, nearest = points[used], nearest[used]
        normals = all_normals[nearest]
        residuals = ((points - old[nearest]) * normals).sum(axis=1)
        (x, y), (nx, ny) = (points - pose[:2]).T, normals.T
        jacobian = np.column_stack([nx, ny, x * ny - y * nx])
        step = np.linalg.lstsq(jacobian, -residuals, rcond=1e-6)[0]
        pose = pose + step
        if iteration > 10 and np.abs(step).max() < 1e-4:
            break
    # The information of a step in the frame of the new scan, as g2o and masat define it.
    c, s = np.cos(pose[2]), np.sin(pose[2])
    jacobian = jacobian @ np.array([(c, -s, 0), (s, c, 0), (0, 0, 1)]) / MATCH_SIGMA
    information = jacobian.T @ jacobian
    # Along a corridor without boxes, a match may slide.
    slides = np.linalg.eigvalsh(information)[0] < 25
    if slides or used.mean() < MIN_OVERLAP or np.sqrt(np.mean(residuals**2)) > MAX_RESIDUAL:
        return None
    return np.r_[pose[:2], np.arctan2(s, c)], information


def loop_closure(
    world: masat.OnlineMap, scans: list[np.ndarray]
) -> tuple[int, np.ndarray, np.ndarray] | None:
    """Return an earlier scan that the last one matches, the measured pose and its information."""
    poses, k = world.poses, len(scans) - 1
    if k < MIN_GAP:
        return None
    # The candidate that is nearest, in units of what the map knows of their relative pose.
    distances = np.linalg.norm(poses[: k - MIN_GAP + 1, :2] - poses[k, :2], axis=1)
    candidates = np.argsort(distances)[:10]
    covariances = world.relative_covariances([(j, k) for j in candidates])
    sigmas = np.sqrt(covariances[:, 0, 0] + covariances[:, 1, 1])
    excess = np.maximum(distances[candidates] - MAX_DISTANCE, 0) / sigmas
    best = int(excess.argmin())
    if excess[best] > 3:
        return None
    j, predicted = int(candidates[best]), covariances[best]
    guess = lie.between(poses[j], poses[k])
    # Where drift is large, ICP begins also at either side of the prediction.
    values, axes = np.linalg.eigh(predicted)
    widest = np.sqrt(values[-1]) * axes[:, -1]
    starts = (0, 1, -1, 2, -2) if np.linalg.norm(widest) > 0.3 else (0,)
    for start in starts:
        found = match(scans[j], scans[k], lie.retract(guess, start * widest))
        if found is None:
            continue
        z, information = found
        off = lie.local(guess, z)
        if off @ np.linalg.solve(predicted + np.linalg.inv(information), off) < GATE:
            return j, z, information
    return None


def rms(poses: np.ndarray, truth: np.ndarray) -> float:
    """Return the root mean square of the errors of positions, in meters."""
    return float(np.sqrt(np.mean(np.sum((poses - truth)[:, :2] ** 2, axis=1))))


def draw(path: str, names: list[str], maps: list[np.ndarray], scans: list[np.ndarray]) -> None:
    """Draw the scans at the poses of each map."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6 * len(maps), 4.5), layout="constrained")
    for axes, name, poses in zip(figure.subplots(1, len(maps)), names, maps, strict=True):
        points = np.concatenate([moved(s, pose) for s, pose in zip(scans, poses, strict=True)])
        axes.plot(*points.T, ",", color="0.3")
        axes.plot(*poses[:, :2].T, linewidth=1)
        axes.set(title=name, aspect="equal", xlabel="x in m", ylabel="y in m")
    figure.savefig(path, dpi=150)


def main(arguments: list[str] | None = None) -> tuple[float, float]:
    """Drive, map, and print the errors; return those of dead reckoning and of the map."""
    parser = argparse.ArgumentParser(description="Map a simulated building.")
    parser.add_argument("--laps", type=float, default=2.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--picture", help="file for a picture of both maps")
    options = parser.parse_args(arguments)

    random = np.random.default_rng(options.seed)
    walls, truth = building(random), way(options.laps)
    world, scans, closures = masat.OnlineMap(2), [], 0
    reckoned = truth.copy()
    for k, pose in enumerate(truth):
        scans.append(scan(walls, pose, random))
        if k == 0:
            world.add_pose(0, pose)
            world.update()
            continue
        world.add_pose(k)
        z = lie.retract(lie.between(truth[k - 1], pose), ODOMETRY_SIGMAS * random.normal(size=3))
        world.add_edges((k - 1, k), z, np.diag(ODOMETRY_SIGMAS**-2.0))
        world.update()
        reckoned[k] = lie.compose(reckoned[k - 1], z)
        closure = loop_closure(world, scans)
        if closure is not None:
            world.add_edges((closure[0], k), closure[1], closure[2])
            world.update()
            closures += 1
    errors = rms(reckoned, truth), rms(world.poses, truth)
    print(f"{len(world)} poses, {closures} loop closures, chi2 {world.chi2:.1f}")
    print(f"error of dead reckoning: {errors[0]:.3f} m, of the map: {errors[1]:.3f} m")
    if options.picture:
        draw(options.picture, ["dead reckoning", "map"], [reckoned, world.poses], scans)
    return errors


if __name__ == "__main__":
    main()

"""The pictures of the pages, drawn by masat: `python docs/pictures/make.py [NAME ..]`.

Needs masat itself, and takes some seconds. Maps are PNG with few colors, all else is SVG.
"""

import sys
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.patches import Ellipse

import masat
from masat import lie
from masat.worlds import add_false_closures, add_fixes, city, manhattan, perturb

plt.rcParams.update(
    {
        "svg.hashsalt": "masat",
        "figure.facecolor": "white",  # The pages also have a dark scheme.
        "font.size": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
    }
)

FOLDER = Path(__file__).parent
BLUE, ORANGE, MAGENTA, GRAY = "#1b4a72", "#d97f23", "#c2006b", "#8a8a8a"


def save(figure, name):
    figure.savefig(FOLDER / f"{name}.svg", bbox_inches="tight", metadata={"Date": None})
    plt.close(figure)


def save_map(figure, name):
    """As PNG with 64 colors, which is smaller than the lines of a map as SVG."""
    from PIL import Image

    path = FOLDER / f"{name}.png"
    figure.savefig(path, dpi=110, bbox_inches="tight", metadata={"Software": None})
    plt.close(figure)
    Image.open(path).convert("RGB").quantize(64, dither=Image.Dither.NONE).save(path, optimize=True)


def draw_map(ax, graph, title, rejected=None, color=BLUE, closures=True):
    ends = graph.poses[graph.edge_indices][:, :, :2]
    odometry = np.diff(graph.edges, axis=1).ravel() == 1
    if closures:
        ax.add_collection(LineCollection(ends[~odometry], colors=ORANGE, linewidths=0.6))
    ax.add_collection(LineCollection(ends[odometry], colors=color, linewidths=0.9))
    if rejected is not None:
        ends = graph.poses[np.searchsorted(graph.ids, rejected)][:, :, :2]
        ax.add_collection(
            LineCollection(ends, colors=MAGENTA, linewidths=0.7, linestyles="dashed", alpha=0.7)
        )
    ax.set_title(title, fontsize=9)
    finish(ax)


def finish(ax):
    ax.autoscale_view()
    ax.set_aspect("equal", "datalim")
    ax.set_xticks([])
    ax.set_yticks([])
    for spine in ax.spines.values():
        spine.set_visible(False)


def draw_pose(ax, pose, color, size=0.35, fill=True):
    """A triangle that points where the robot looks."""
    shape = np.array([(1, 0), (-0.6, 0.6), (-0.6, -0.6)]) * size
    c, s = np.cos(pose[2]), np.sin(pose[2])
    corners = shape @ np.array([(c, s), (-s, c)]) + pose[:2]
    ax.fill(*corners.T, facecolor=color if fill else "white", edgecolor=color, lw=1.2, zorder=3)


def ellipse_of(position, covariance, sigmas, **look):
    values, vectors = np.linalg.eigh(covariance)
    angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
    width, height = 2 * sigmas * np.sqrt(values[::-1])
    return Ellipse(position, width, height, angle=angle, **look)


def gauge():
    """The same map and its uncertainties for two choices of the gauge-fixed node."""
    graph = masat.solve(perturb(manhattan(60, 75, extent=6, seed=4), (0.1, 0.1, 0.05))).graph
    figure, axes = plt.subplots(1, 2, figsize=(7, 3.2))
    first = lie.compose(graph.poses[[0]], lie.inverse(graph.poses[[0]]))
    for ax, root in zip(axes, (0, 45), strict=True):
        rooted = graph.with_root(root)
        covariances = masat.covariances(rooted)
        # Both are drawn with the first node at the origin, so that they can be compared.
        poses = lie.compose(first, graph.poses)
        draw_map(ax, graph.with_poses(poses), f"node {root} is not optimized")
        for pose, covariance in zip(poses[::3], covariances[::3], strict=True):
            c, s = np.cos(pose[2]), np.sin(pose[2])
            turn = np.array([(c, -s), (s, c)])
            ax.add_patch(
                ellipse_of(
                    pose[:2], turn @ covariance[:2, :2] @ turn.T, 2, color=GRAY, alpha=0.25, lw=0
                )
            )
        k = np.searchsorted(graph.ids, root)
        ax.plot(*poses[k, :2], "o", mfc="white", mec="black", ms=8, zorder=4)
        ax.autoscale_view()
    save(figure, "gauge")


def information():
    """One edge: measured pose with its ellipse, actual pose, residual."""
    a, measured, actual = np.array([0, 0, 0.3]), (3.0, 0.4, 0.5), np.array([3.6, 0.5, 1.35])
    b = lie.compose(a[None], np.array([measured]))[0]
    figure, ax = plt.subplots(figsize=(5.5, 2.9))
    c, s = np.cos(b[2]), np.sin(b[2])
    turn = np.array([(c, -s), (s, c)])
    covariance = turn @ np.diag([0.35**2, 0.15**2]) @ turn.T
    for sigmas in (1, 2):
        ax.add_patch(ellipse_of(b[:2], covariance, sigmas, fc=BLUE, alpha=0.13, lw=0))
    ax.annotate("", b[:2], a[:2], arrowprops={"arrowstyle": "->", "color": BLUE, "shrinkA": 12})
    ax.annotate("", actual[:2], b[:2], arrowprops={"arrowstyle": "->", "color": MAGENTA, "lw": 2})
    draw_pose(ax, a, BLUE)
    draw_pose(ax, b, BLUE, fill=False)
    draw_pose(ax, actual, ORANGE)
    ax.text(0, -0.55, "pose a", ha="center")
    ax.text(1.35, 0.85, "measurement z", color=BLUE, ha="center")
    ax.text(b[0], b[1] + 1.0, "where z puts b", color=BLUE, ha="center")
    ax.text(actual[0] + 0.45, actual[1] - 0.05, "pose b", color=ORANGE)
    ax.text(b[0] + 0.62, b[1] - 0.28, "residual e", color=MAGENTA)
    ax.text(b[0] + 0.75, b[1] + 0.6, "one and two standard\ndeviations", color=GRAY)
    finish(ax)
    save(figure, "information")


def chi2():
    """Chi2 of the edges of three maps: honest, with a wrong scale, with a few false edges."""
    clean = perturb(city(2000, seed=1), (0.1, 0.1, 0.05))
    spoiled, _ = add_false_closures(clean, "random", 0.0015, seed=1)
    too_sharp = replace(clean, information=clean.information * 40)
    maps = {
        "honest measurements": masat.solve(clean),
        "information 40 times too large": masat.solve(too_sharp, init="chordal"),
        "three loop closures are false": masat.solve(spoiled),
    }
    figure, axes = plt.subplots(1, 3, figsize=(8.4, 2.5), sharey=True, layout="constrained")
    bins = np.logspace(-2, 5, 50)
    for ax, (title, result) in zip(axes, maps.items(), strict=True):
        counts, _ = np.histogram(result.graph.chi2_per_edge, bins)
        ax.stairs(np.maximum(counts, 0.5), bins, fill=True, color=BLUE, baseline=0.5)
        ax.axvline(26, color=MAGENTA, ls="dashed")
        ax.set(xscale="log", yscale="log", xlabel="chi2 of an edge", ylim=(0.5, 2000))
        ax.set_title(f"{title}\nreduced chi2 {result.reduced_chi2:.3g}", fontsize=9)
    axes[0].set_ylabel("edges")
    axes[0].text(40, 200, "one honest edge\nin 100,000\nhas more", color=MAGENTA, fontsize=8)
    save(figure, "chi2")


def local_minima():
    """Three maps of one graph, each of them a minimum of chi2."""
    graph = perturb(manhattan(1000, 1550, extent=31, seed=8), (0.2, 0.2, 0.2), seed=8)
    figure, axes = plt.subplots(1, 3, figsize=(8.4, 3), layout="constrained")
    inits = {"auto": "auto", "spanning_tree": "the spanning tree", "odometry": "odometry"}
    for ax, (init, name) in zip(axes, inits.items(), strict=True):
        result = masat.solve(graph, init=init, optimizer="gn", max_iterations=200)
        draw_map(ax, result.graph, f"from {name}: chi2 {result.chi2:,.0f}")
    save_map(figure, "local_minima")


def certificate():
    """The cost of a rotation residual, and the surrogate that touches it from below."""
    e, touch = np.linspace(-np.pi, np.pi, 400), 0.9
    s = touch / np.sin(touch)
    surrogate = touch**2 + 2 * s * (np.cos(touch) - np.cos(e))
    figure, ax = plt.subplots(figsize=(5, 2.7))
    ax.plot(e, e**2, color=BLUE, lw=2)
    ax.plot(e, surrogate, color=ORANGE, lw=2)
    ax.plot(touch, touch**2, "o", color="black")
    ax.annotate(
        "equal here: the residual\nof the map",
        (touch, touch**2),
        (1.15, -0.9),
        va="top",
        arrowprops={"arrowstyle": "-", "color": GRAY},
    )
    ax.text(-2.75, 8.6, "chi2 of the edge", color=BLUE)
    ax.text(-2.2, 0.6, "surrogate", color=ORANGE)
    ax.set(xlabel="rotation residual e [rad]", ylabel="cost", ylim=(-3, 10.5))
    save(figure, "certificate")


def trusted_map():
    """From measurements to a map: odometry alone, and solved."""
    graph = perturb(city(2000, seed=0), (0.1, 0.1, 0.05))
    figure, axes = plt.subplots(1, 2, figsize=(7.5, 3.6), layout="constrained")
    draw_map(axes[0], masat.initialize(graph, "odometry"), "odometry alone")
    draw_map(axes[1], masat.solve(graph).graph, "masat.solve(graph)")
    save_map(figure, "trusted_map")


def false_closures():
    """A map that false loop closures bend, and one that they cannot bend."""
    clean = perturb(city(1200, seed=0), (0.1, 0.1, 0.05))
    graph, _ = add_false_closures(clean, "alias", 0.1, seed=0)
    with np.errstate(all="ignore"):
        plain = masat.solve(graph)
        robust = masat.solve(graph, robust=True)
    rejected = robust.closures[~robust.closures["kept"]]
    pairs = np.stack([rejected["from"], rejected["to"]], axis=1)
    figure, axes = plt.subplots(1, 2, figsize=(7.5, 3.6), layout="constrained")
    draw_map(axes[0], plain.graph, "masat.solve(graph)")
    draw_map(axes[1], robust.graph, "masat.solve(graph, robust=True)", pairs)
    axes[1].plot([], [], color=MAGENTA, ls="dashed", label="rejected")
    axes[1].legend(loc="lower left", frameon=False, fontsize=8)
    save_map(figure, "false_closures")


def gps():
    """Position fixes, a few of them bad, and the map that goes through the good ones."""
    graph = perturb(manhattan(1500, 2300, extent=60, seed=3), (0.05, 0.05, 0.02), seed=3)
    graph, _ = add_fixes(graph, 0.03, 1, bad=0.2, frame=(60, 30, 0.5), seed=3)
    result = masat.solve(graph, robust=True)
    odometry = masat.initialize(graph.with_priors(None), "odometry")
    figure, axes = plt.subplots(1, 2, figsize=(7.5, 3.4), layout="constrained")
    draw_map(axes[0], odometry, "odometry alone, in a frame of its own", closures=False)
    draw_map(axes[1], result.graph, "with position fixes", closures=False)
    kept = np.asarray(result.decision.kept_priors)
    fixes = graph.priors.measurements[:, :2]
    axes[1].plot(*fixes[kept].T, "+", color=ORANGE, ms=8, mew=1.6, label="fix, kept")
    axes[1].plot(*fixes[~kept].T, "x", color=MAGENTA, ms=6, mew=1.6, label="fix, rejected")
    axes[1].legend(loc="upper right", frameon=False, fontsize=8)
    finish(axes[1])
    save_map(figure, "gps")


def merging():
    """Two sessions in frames of their own, and merged."""
    world = perturb(manhattan(300, 520, extent=11, seed=5), (0.04, 0.04, 0.015), seed=5)
    truth = manhattan(300, 520, extent=11, seed=5)
    cut = 150
    monday = world.without_nodes(np.arange(cut, 300))
    tuesday = world.without_nodes(np.arange(cut)).relabel(-cut)
    across = (world.edges >= cut).sum(axis=1) == 1
    pairs = np.sort(world.edges[across], axis=1)
    links = [(0, i, 1, j - cut) for i, j in pairs if j - i > 1][:12]
    between = [lie.between(truth.poses[[i]], truth.poses[[cut + j]])[0] for _, i, _, j in links]
    merged = masat.solve(masat.merge([monday, tuesday], (links, between))).graph
    figure, axes = plt.subplots(1, 3, figsize=(8.4, 3), layout="constrained")
    draw_map(axes[0], masat.solve(monday).graph, "Monday", closures=False)
    draw_map(axes[1], masat.solve(tuesday).graph, "Tuesday", color=MAGENTA, closures=False)
    for session, color in ((0, BLUE), (1, MAGENTA)):
        part = merged.without_nodes(merged.ids[masat.sessions(merged) != session])
        draw_map(axes[2], part, "merged", color=color, closures=False)
    ends = merged.poses[merged.edge_indices][:, :, :2]
    linked = (merged.edges >= 1000000).sum(axis=1) == 1
    axes[2].add_collection(LineCollection(ends[linked], colors=ORANGE, linewidths=1.5))
    save_map(figure, "merging")


def online():
    """A map that grows: three of its states."""
    graph = perturb(city(900, seed=2), (0.08, 0.08, 0.04))
    figure, axes = plt.subplots(1, 3, figsize=(8.4, 3), layout="constrained")
    for ax, count in zip(axes, (300, 600, 900), strict=True):
        part = graph.without_nodes(graph.ids[count:])
        draw_map(ax, masat.solve(part).graph, f"after {count} poses")
    save_map(figure, "online")


PICTURES = {
    function.__name__: function
    for function in (
        gauge,
        information,
        chi2,
        local_minima,
        certificate,
        trusted_map,
        false_closures,
        gps,
        merging,
        online,
    )
}

if __name__ == "__main__":
    for name in sys.argv[1:] or PICTURES:
        PICTURES[name]()

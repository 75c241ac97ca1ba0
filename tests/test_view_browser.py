"""The view as a person uses it: a headless Chromium opens the page, points, clicks and types.

Needs the extra `browser` and Chromium (Debian's package `chromium`, or MASAT_CHROMIUM).
"""

import io
import os
import shutil

import matplotlib.pyplot as plt
import numpy as np
import pytest
from click.testing import CliRunner

import masat
from masat.cli import cli
from masat.worlds import add_false_closures, manhattan, perturb, sphere

playwright = pytest.importorskip("playwright.sync_api", reason="needs the extra browser")
NAMES = ("chromium", "chromium-browser", "google-chrome")
CHROMIUM = os.environ.get("MASAT_CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium: apt-get install chromium")

# Draws by software, which every machine can.
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
TIMEOUT = 120_000


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield browser
        browser.close()


def until(page, condition):
    """Wait for a condition; `wait_for_function` needs eval, which the page forbids."""
    for _ in range(TIMEOUT // 20):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(20)
    pytest.fail(f"never: {condition}")


@pytest.fixture
def show(browser, tmp_path):
    """Open a view; afterwards nothing may have been fetched, and no error written."""
    said, fetched = [], []
    contexts = []

    def show(view, **options):
        path = tmp_path / "map.html"
        view.save(path)
        context = browser.new_context(viewport={"width": 1000, "height": 700}, **options)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(TIMEOUT)
        page.on("console", lambda message: said.append(message.text))
        page.on("pageerror", lambda error: said.append(str(error)))
        page.on("request", lambda request: fetched.append(request.url))
        page.goto(path.as_uri())
        until(page, "globalThis.masat !== undefined")
        return page

    yield show
    for context in contexts:
        context.close()
    outside = [url for url in fetched if not url.startswith(("data:", "blob:", "file:"))]
    assert outside == []
    assert sum(url.startswith("file:") for url in fetched) == len(contexts)
    # Drivers remark on the speed of reading pixels, which screenshots do.
    assert [text for text in said if "GPU stall" not in text] == []


@pytest.fixture(scope="module")
def spoiled():
    """A graph with false loop closures, and its robust result."""
    world = perturb(manhattan(150, 260, extent=8, seed=2), (0.05, 0.05, 0.02), seed=2)
    graph, _ = add_false_closures(masat.solve(world).graph, "random", 0.1, seed=3)
    result = masat.solve(graph, robust=True)
    assert not result.kept.all()
    return graph, result


@pytest.fixture
def page(show, spoiled):
    graph, result = spoiled
    return show(masat.view(result, before=graph), color_scheme="light")


def middle_of(page, edge, fraction=0.5):
    """The pixel on an edge at a fraction of its length."""
    return page.evaluate(
        """([edge, t]) => {
            const [a, b] = masat.model.ends(edge).map((node) => masat.picker.pixelOf(node));
            return [0, 1].map((c) => (1 - t) * a[c] + t * b[c]);
        }""",
        [edge, fraction],
    )


def click_edge(page, edge):
    """Click where no other edge is as near to the pointer."""
    for fraction in np.linspace(0.2, 0.8, 31):
        x, y = middle_of(page, edge, float(fraction))
        there = page.evaluate("([x, y]) => masat.picker.at(x, y)", [x, y])
        if there == {"kind": "edge", "index": edge}:
            page.mouse.click(x, y)
            return
    pytest.fail(f"edge {edge} is hidden by others")


def row(page, name):
    """The text beside a name in the card."""
    return (
        page.locator("#details tr", has=page.locator(f"th:text-is('{name}')"))
        .locator("td")
        .inner_text()
    )


def pixels(page):
    """The page as an image, (rows, columns, 3), from 0 to 1."""
    return plt.imread(io.BytesIO(page.screenshot()), format="png")[..., :3]


def near(image, color, tolerance=0.12):
    """How many pixels have a color."""
    wanted = [int(color[k : k + 2], 16) / 255 for k in (1, 3, 5)]
    return int((np.abs(image - wanted).max(axis=-1) < tolerance).sum())


def settle(page):
    """Wait for flights, and for the picture after them."""
    until(page, "!masat.camera.flight && !masat.drawing.isMoving && !masat.drawing.requested")
    page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")


def test_a_picked_edge_tells_its_chi2(page, spoiled):
    graph, result = spoiled
    chi2 = graph.with_poses(result.poses).chi2_per_edge
    edge = int(np.flatnonzero(~result.kept)[0])
    click_edge(page, edge)
    a, b = graph.edges[edge]
    heading = page.locator("#details h3").inner_text()
    assert heading.split() == ["Edge", str(a), "→", str(b), "rejected"]
    assert float(row(page, "chi2")) == pytest.approx(chi2[edge], rel=1e-5)
    reason = result.closures["reason"][result.closures["edge"] == edge][0]
    assert row(page, "decision") == reason
    assert row(page, "index") == f"#{edge}"
    measured = [float(part.split()[-1]) for part in row(page, "measurement").split(",")]
    np.testing.assert_allclose(measured, graph.measurements[edge], rtol=1e-4)
    page.keyboard.press("Escape")
    page.mouse.move(5, 695)
    page.locator("#details").wait_for(state="hidden")


def test_pointing_at_a_node_tells_about_it(page, spoiled):
    graph, result = spoiled
    x, y = page.evaluate("masat.picker.pixelOf(40)")
    page.mouse.move(x, y)
    page.locator("#details[data-hover]").wait_for()
    assert page.locator("#details h3").inner_text().split() == ["Node", str(graph.ids[40])]
    position = [float(part.split()[-1]) for part in row(page, "position").split(",")]
    np.testing.assert_allclose(position, result.poses[40, :2], rtol=1e-4, atol=1e-4)
    assert int(row(page, "edges")) == (graph.edges == graph.ids[40]).any(axis=1).sum()


def test_rejected_edges_are_seen_at_first_sight(page):
    settle(page)
    shown = near(pixels(page), "#c2006b")
    assert shown > 1000
    page.get_by_label("rejected").uncheck()
    settle(page)
    # The swatches of the panel and of the legend remain.
    assert near(pixels(page), "#c2006b") < 0.1 * shown


def test_the_list_exported_is_replayed_exactly(page, spoiled, tmp_path):
    graph, result = spoiled
    closure = int(np.flatnonzero(result.kept & ~_odometry(graph))[4])
    page.locator("#query").fill(f"#{closure}")
    page.keyboard.press("Enter")
    page.locator("#details h3").wait_for()
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("x")
    assert "switched off" in page.locator("#details h3").inner_text()
    with page.expect_download() as download:
        page.keyboard.press("e")
    listed = tmp_path / "off.txt"
    download.value.save_as(listed)
    off = masat.formats.read_edge_list(listed, graph)
    expected = [*np.flatnonzero(~result.kept).tolist(), closure]
    assert off.tolist() == sorted(expected)
    source, out = tmp_path / "graph.g2o", tmp_path / "map.g2o"
    masat.write(graph, source)
    words = ["solve", source, "--without", listed, "-o", out, "-q"]
    assert CliRunner().invoke(cli, list(map(str, words))).exit_code == 0
    again = masat.solve(masat.read(source).without_edges(off))
    np.testing.assert_array_equal(masat.read(out).poses, _rewritten(again.graph, tmp_path).poses)
    # Back to what the solve decided.
    page.get_by_role("button", name="As before").click()
    assert page.evaluate("masat.model.off().length") == (~result.kept).sum()


def _odometry(graph):
    return np.abs(np.diff(graph.edge_indices, axis=1)[:, 0]) == 1


def _rewritten(graph, folder):
    masat.write(graph, folder / "again.g2o")
    return masat.read(folder / "again.g2o")


def test_the_slider_shows_the_iterations(show, spoiled):
    graph, _ = spoiled
    world = graph.without_edges(np.flatnonzero(~spoiled[1].kept))
    steps = []
    result = masat.solve(world, init="odometry", report_poses=steps.append)
    page = show(masat.view(result, iterations=steps))
    slider = page.locator("#state")
    assert int(slider.get_attribute("max")) == result.iterations
    slider.fill("0")
    text = page.locator("#state-text")
    assert text.inner_text().startswith("initial guess: ")
    assert float(text.inner_text().split()[-1]) == pytest.approx(result.initial_chi2, rel=1e-5)
    drawn = page.evaluate("Array.from(masat.drawing.positions.values.subarray(4 * 99, 4 * 99 + 2))")
    center = page.evaluate("masat.model.header.center")
    np.testing.assert_allclose(np.add(drawn, center), steps[0][99, :2], atol=1e-4)
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("ArrowRight")
    assert text.inner_text().startswith(f"iteration 1 of {result.iterations}: ")
    chi2 = float(text.inner_text().split()[-1])
    assert chi2 == pytest.approx(result.history[0].chi2, rel=1e-5)
    page.keyboard.press("b")
    assert text.inner_text().startswith("result: ")
    page.keyboard.press("b")
    assert text.inner_text().startswith("initial guess: ")
    page.keyboard.press("Space")
    until(page, "masat.model.isResult")


def test_the_worst_edges_are_listed_and_flown_to(page, spoiled):
    graph, result = spoiled
    page.locator("#ranking").select_option("map")
    chi2 = np.where(result.kept, graph.with_poses(result.poses).chi2_per_edge, -1)
    worst = int(chi2.argmax())
    first = page.locator("#edges button").first
    a, b = graph.edges[worst]
    assert first.inner_text().split()[:3] == [str(a), "→", str(b)]
    before = page.evaluate("masat.camera.pixelsPerMeter")
    first.click()
    settle(page)
    x, y = middle_of(page, worst)
    covered = page.evaluate("masat.camera.covered")
    assert abs(x - (1000 - covered) / 2) < 5
    assert abs(y - 350) < 5
    assert page.evaluate("masat.camera.pixelsPerMeter") > before
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("n")
    second = int(np.argsort(-chi2, kind="stable")[1])
    assert page.evaluate("masat.model.selected") == {"kind": "edge", "index": second}
    page.keyboard.press("f")
    settle(page)
    assert page.evaluate("masat.camera.pixelsPerMeter") == pytest.approx(before)


@pytest.mark.parametrize(
    ("typed", "found"),
    [
        ("7", {"kind": "node", "index": 7}),
        ("#3", {"kind": "edge", "index": 3}),
        ("3 4", {"kind": "edge", "index": 3}),
        ("4-3", {"kind": "edge", "index": 3}),
        ("9999", "There is no node 9999."),
        ("0 77", "No edge joins 0 and 77."),
        ("#99999", "There are"),
        ("here", "Type the id"),
    ],
)
def test_nodes_and_edges_are_found(page, typed, found):
    page.locator("#query").fill(typed)
    page.get_by_role("button", name="Find").click()
    if isinstance(found, str):
        assert page.locator("#message").inner_text().startswith(found)
    else:
        assert page.evaluate("masat.model.selected") == found


def test_colors_layers_theme_and_help(show, spoiled):
    graph, result = spoiled
    stamped = graph.with_stamps(np.arange(len(graph)) * 0.5)
    weighted = masat.optimize(stamped.with_poses(result.poses), loss="cauchy")
    page = show(masat.view(weighted), color_scheme="dark")
    select = page.locator("#coloring")
    keys = select.locator("option").evaluate_all("all => all.map((one) => one.value)")
    assert keys == ["kind", "chi2", "time", "weight"]
    legend = page.locator("#legend")
    for key, said in (("chi2", "chi2 of the edge"), ("time", "[s]"), ("weight", "robust weight")):
        select.select_option(key)
        assert said in legend.inner_text()
        settle(page)
    # The paper is dark, then light.
    assert near(pixels(page), "#10151c", 0.02) > 1e5
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("t")
    settle(page)
    assert near(pixels(page), "#ffffff", 0.02) > 1e5
    page.keyboard.press("1")
    assert not page.get_by_label("odometry").is_checked()
    page.keyboard.press("?")
    assert page.locator("dialog").is_visible()
    page.keyboard.press("Escape")
    page.keyboard.press("p")
    assert not page.locator("#panel").is_visible()
    page.locator("#unfold").click()
    assert page.locator("#panel").is_visible()


def test_sessions_components_and_labels_have_colors(show, spoiled):
    graph = spoiled[0].with_poses(spoiled[1].poses)
    merged = masat.merge([graph, graph], between=([(0, 3, 1, 3)], [(0, 0, 0)]))
    apart = merged.without_edges([len(merged.edges) - 1])
    beside = merged.poses.copy()
    beside[masat.sessions(merged) == 1, 0] += 10
    labeled = masat.PoseGraph.from_arrays(
        apart.edges,
        apart.measurements,
        apart.information,
        poses=beside,
        labels=np.arange(len(apart.edges)) % 3,
    )
    page = show(masat.view(labeled))
    for key, said in (("session", "session 1"), ("component", "component 0"), ("label", "2")):
        page.locator("#coloring").select_option(key)
        assert said in page.locator("#legend").inner_text()
        settle(page)
        assert near(pixels(page), "#0072b2") > 300  # the first category
        page.keyboard.press("Escape")


def test_everything_else_is_drawn_and_picked(show, spoiled):
    graph, result = spoiled
    believed = graph.without_edges(np.flatnonzero(~result.kept)).with_poses(result.poses)
    seen = masat.landmarks([(3, 900), (9, 900)], [(1, 2), (2, 1)])
    fixes = masat.gps(believed.ids[::30], believed.poses[::30, :2] + 0.5, sigma=1.0)
    solved = masat.solve(believed.with_landmarks(seen).with_priors(fixes))
    page = show(masat.view(solved, truth=believed, covariances=True))
    for name in ("priors", "landmarks", "truth", "95 % ellipses"):
        assert page.get_by_label(name).is_checked()
    x, y = page.evaluate("masat.picker.pixelOf(masat.drawing.first.landmarks)")
    there = page.evaluate("([x, y]) => masat.picker.at(x, y)", [x, y])
    assert there == {"kind": "landmark", "index": 0}
    page.mouse.click(x, y)
    assert page.locator("#details h3").inner_text() == "Landmark 900"
    assert row(page, "observations") == "2"
    page.locator("#query").fill("60")
    page.keyboard.press("Enter")
    k = int(solved.graph.index(60))
    sigma = np.sqrt(np.diag(_covariance_of_position(solved.graph, k)))
    shown = [float(part.split()[1]) for part in row(page, "std. dev.").split(",")]
    np.testing.assert_allclose(shown, sigma, rtol=5e-3)


def _covariance_of_position(graph, k):
    (own,) = masat.covariances(graph, [graph.ids[k]])
    c, s = np.cos(graph.poses[k, 2]), np.sin(graph.poses[k, 2])
    turn = np.array([[c, -s], [s, c]])
    return turn @ own[:2, :2] @ turn.T


def test_a_3d_map_turns(show):
    graph = perturb(sphere(200, seed=0), (0.05, 0.05, 0.05, 0.02, 0.02, 0.02), seed=0)
    result = masat.solve(graph)
    page = show(masat.view(result))
    before = page.evaluate("masat.camera.camera.position.toArray()")
    page.mouse.move(300, 350)
    page.mouse.down()
    page.mouse.move(400, 380, steps=5)
    page.mouse.up()
    after = page.evaluate("masat.camera.camera.position.toArray()")
    assert np.linalg.norm(np.subtract(after, before)) > 0.1 * np.linalg.norm(before)
    assert np.linalg.norm(after) == pytest.approx(np.linalg.norm(before))
    # A drag is no click.
    assert page.evaluate("masat.model.selected") is None
    page.get_by_role("button", name="top").click()
    settle(page)
    edge = int(result.graph.chi2_per_edge.argmax())
    click_edge(page, edge)
    chi2 = result.graph.chi2_per_edge[edge]
    assert float(row(page, "chi2")) == pytest.approx(chi2, rel=1e-5)


def test_ids_of_64_bits_keep_all_digits(show):
    letter = ord("a") << 56
    graph = masat.PoseGraph.from_arrays(
        [(letter + k, letter + k + 1) for k in range(5)],
        [(1, 0, 0)] * 5,
        poses=[(k, 0, 0) for k in range(6)],
    )
    page = show(masat.view(graph))
    page.locator("#query").fill(str(letter + 3))
    page.keyboard.press("Enter")
    assert page.evaluate("masat.model.selected") == {"kind": "node", "index": 3}
    assert page.locator("#details h3").inner_text().split()[1] == str(letter + 3)

"""The view of city10000 and of two worlds with 100,000 edges: size, time to the picture, frames.

Run `python -m benchmarks.view`; needs the extra `browser`, Chromium (MASAT_CHROMIUM or on the
path), and for city10000 the data (MASAT_DATA). Everything is drawn by software (SwiftShader), on
as many cores as there are: other work on the machine makes it slower, so the load is printed too.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from time import perf_counter

from playwright.sync_api import sync_playwright

import masat
from benchmarks.data import DATA
from masat.worlds import manhattan, perturb, torus

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
NAMES = ("chromium", "chromium-browser", "google-chrome")
EDGES = 100_000
# Wanted: MB of the file and seconds until it is drawn of city10000, frames a second of all.
LARGEST, LATEST, FEWEST = 3.0, 2.0, 15.0
SECONDS = 4

# Moves the map as a person does who drags it, first until the level of detail is found.
MOVE = """async (seconds) => {
  const { drawing, camera } = masat;
  const moveFor = async (milliseconds) => {
    const begin = performance.now(), first = drawing.frames;
    while (performance.now() - begin < milliseconds) {
      if (camera.is3d) camera.camera.position.applyAxisAngle(camera.camera.up, 0.01);
      else camera.zoomBy(drawing.frames % 60 < 30 ? 1.02 : 1 / 1.02);
      camera.controls.update();
      drawing.move();
      await new Promise((done) => requestAnimationFrame(done));
    }
    return 1000 * (drawing.frames - first) / (performance.now() - begin);
  };
  await moveFor(1000 * seconds);
  return [await moveFor(1000 * seconds), drawing.level];
}"""


def _graphs() -> dict[str, masat.PoseGraph]:
    small = manhattan(EDGES // 2, EDGES, extent=220, seed=0)
    return {
        "city10000": masat.read(DATA / "2d/city10000.g2o"),
        "manhattan, 100,000 edges": perturb(small, (0.01, 0.01, 0.001), seed=0),
        "torus, 100,000 edges": torus(EDGES // 2, EDGES, seed=0),
    }


def main() -> None:
    """Print a table."""
    chromium = os.environ.get("MASAT_CHROMIUM") or next(filter(None, map(shutil.which, NAMES)))
    print(f"wanted: city10000 at most {LARGEST} MB and {LATEST} s, {FEWEST} frames a second of all")
    print(f"{'view of':<26}{'MB':>7}{'write':>9}{'drawn':>9}{'frames/s':>10}{'level':>7}  load")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        for name, graph in _graphs().items():
            file = Path(folder, "map.html")
            steps: list[masat.arrays.Floats] = []
            shown: masat.PoseGraph | masat.Result = graph
            if name == "city10000":
                shown = masat.solve(graph, init="odometry", report_poses=steps.append)
            begin = perf_counter()
            masat.view(shown, file, before=graph if steps else None, iterations=steps)
            seconds = perf_counter() - begin
            browser = driver.chromium.launch(executable_path=chromium, args=FLAGS)
            page = browser.new_page(viewport={"width": 1280, "height": 800})
            # The program that draws has started before.
            page.goto("about:blank")
            page.evaluate("document.createElement('canvas').getContext('webgl2') !== null")
            page.goto(file.as_uri())
            while not page.evaluate("globalThis.masat !== undefined"):
                page.wait_for_timeout(20)
            drawn = page.evaluate("masat.firstFrame") / 1000
            frames, level = page.evaluate(MOVE, SECONDS)
            browser.close()
            print(
                f"{name:<26}{file.stat().st_size / 1e6:>7.2f}{seconds:>7.2f} s{drawn:>7.2f} s"
                f"{frames:>10.1f}{level:>7}{os.getloadavg()[0]:>6.1f}"
            )


if __name__ == "__main__":
    main()

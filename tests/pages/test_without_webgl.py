"""The pages in a browser without WebGL2: static figures, a sentence, and no control that does nothing."""

import shutil
from threading import Thread

import numpy as np
import pytest
from matplotlib import image

from cicatrix.pages.planner import Planner
from cicatrix.pages.planning import PlanningTable
from cicatrix.pages.report import write_comparison, write_report
from cicatrix.pages.server import PlanServer

from .conftest import CENTRE, grid
from .test_in_a_browser import CHROMIUM, playwright

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
    pytest.mark.xdist_group("browser"),
]
FLAGS = ["--no-sandbox", "--disable-gpu", "--disable-3d-apis", "--disable-webgl", "--disable-webgl2"]


@pytest.fixture(scope="module")
def opened():
    """Open a page in a browser that draws nothing in three dimensions; at the end, check for errors."""
    faults = []
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)

        def make(url):
            page = chromium.new_page(viewport={"width": 1000, "height": 900})
            page.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
            page.on("pageerror", lambda error: faults.append(str(error)))
            page.goto(str(url))
            page.wait_for_selector("body[data-ready]")
            return page

        yield make
        chromium.close()
    assert faults == []


@pytest.fixture(scope="module")
def drawn(runs, tmp_path_factory):
    """Return a folder with the report of a run with figures, one without, and a comparison."""
    folder = tmp_path_factory.mktemp("still")
    run = shutil.copytree(runs / "solid", folder / "run")
    (run / "figures").mkdir(exist_ok=True)
    for name, colour in (("surface", (0.0, 0.6, 0.2)), ("section", (0.2, 0.2, 0.7))):
        image.imsave(run / "figures" / f"{name}.png", np.broadcast_to(np.array(colour), (60, 100, 3)).copy())
    write_report(run, folder / "with")
    write_report(runs / "plane", folder / "without")
    write_comparison([run, runs / "other"], folder / "side")
    return folder


def dead(page):
    """Return the names of the controls in the parts that cannot be drawn, as far as they can be seen."""
    inside = "[data-body-controls], [data-slices-controls], [data-body], [data-slices]"
    seen = page.locator(f":is({inside}) :is(button, input, select)")
    return [control.evaluate("e => e.dataset.save ?? e.id ?? e.name") for control in seen.all() if control.is_visible()]


def test_a_report_shows_its_static_figures(opened, drawn):
    page = opened((drawn / "with" / "index.html").as_uri())
    assert page.evaluate("document.createElement('canvas').getContext('webgl2')") is None
    for part, name in (("[data-body]", "surface"), ("[data-slices]", "section")):
        still = page.locator(f"{part} img.still")
        assert still.is_visible()
        assert still.get_attribute("src") == f"figures/{name}.png"
        assert still.evaluate("e => e.naturalWidth") == 100
        assert "no WebGL2" in page.locator(f"{part} .gap").inner_text()
        assert not page.locator(f"{part} canvas, {part} .canvas").is_visible()
    assert dead(page) == ["nifti"]
    with page.expect_download() as waiting:
        page.locator('[data-save="nifti"]').click()
    assert waiting.value.suggested_filename.endswith(".nii.gz")
    assert page.locator('[data-chart="closing"] svg').first.is_visible()


def test_a_report_without_figures_says_where_the_numbers_are(opened, drawn):
    page = opened((drawn / "without" / "index.html").as_uri())
    assert "figures.pdf, do not need it" in page.locator("[data-body] .gap").inner_text()
    assert page.locator("img.still").count() == 0
    assert dead(page) == ["nifti"]


def test_runs_side_by_side_show_the_figure_of_each(opened, drawn):
    page = opened((drawn / "side" / "index.html").as_uri())
    assert page.locator('[data-body="A"] img.still').evaluate("e => e.naturalWidth") == 100
    assert page.locator("[data-body] .gap").count() == 2
    assert dead(page) == []


def test_a_resection_is_planned_by_its_numbers(opened, tmp_path):
    table = PlanningTable(grid(), grid(), {"phantom": "half-ellipsoid", "side": "left"}, ())
    server = PlanServer(Planner(table, tmp_path / "out", tmp_path / "site"))
    Thread(target=server.serve_forever, daemon=True).start()
    try:
        page = opened(server.address)
        page.locator("#radius").fill("8")
        page.wait_for_selector("#percent:has-text('3.1 %')")
        assert "no WebGL2" in page.locator("[data-slices] .gap").inner_text()
        page.locator("#x").fill(str(CENTRE[0] - 100.0))
        page.locator("#x").press("Tab")
        page.wait_for_selector("#depth:has-text('outside, 79.5 mm from the breast')")
        assert "outside the breast that is labelled" in page.locator("#against").inner_text()
        assert dead(page) == []
        page.close()  # it asks for progress every second
    finally:
        server.shutdown()
        server.server_close()

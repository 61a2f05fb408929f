"""Pages in headless Chromium: what is drawn, what the controls change, and that nothing else is requested."""

import io
import re
import shutil
import time
from threading import Thread

import numpy as np
import pytest
from matplotlib import image

from cicatrix.cli.plan import build_table
from cicatrix.files.images import write_volume
from cicatrix.image.phantom import phantom
from cicatrix.pages.planner import Planner
from cicatrix.pages.report import write_comparison, write_report
from cicatrix.pages.server import PlanServer

from .conftest import write_run

playwright = pytest.importorskip("playwright.sync_api")
CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
    pytest.mark.xdist_group("browser"),
]
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
LONG = 60_000  # ms


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield chromium
        chromium.close()


@pytest.fixture
def opened(browser):
    """Open a page and wait until it is drawn; at the end, check for errors and for requests to other places."""
    faults, asked, contexts = [], [], []

    def make(url, home="file:", **options):
        context = browser.new_context(viewport={"width": 1200, "height": 900}, **options)
        context.set_default_timeout(LONG)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: faults.append(message.text) if message.type == "error" else None)
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("dialog", lambda dialog: faults.append("dialog"))
        page.on("request", lambda request: asked.append(request.url))
        page.goto(str(url))
        page.wait_for_selector("body[data-ready]")
        make.home = home
        return page

    yield make
    for context in contexts:
        context.close()
    assert not faults
    assert not [url for url in asked if not url.startswith((make.home, "data:", "blob:"))]


@pytest.fixture(scope="module")
def reports(runs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("reports")
    for name in ("plane", "solid", "stopped"):
        write_report(runs / name, folder / name)
    write_comparison([runs / "solid", runs / "other"], folder / "side")
    return folder


def pixels(locator):
    """Return a screenshot (height, width, 3), 0 to 1."""
    return image.imread(io.BytesIO(locator.screenshot()))[..., :3]


def is_blank(seen):
    inner = seen[10:-10, 10:-10]
    return inner.std(axis=(0, 1)).max() < 0.02


def shown(page, letter="A", *, unlike=None):
    """Return the picture of a body; given an earlier picture, wait until the controls have changed it."""
    canvas = page.locator(f'[data-body="{letter}"]').locator(".canvas")
    if unlike is not None:
        return changed(canvas, unlike)
    time.sleep(0.3)
    return pixels(canvas)


def changed(locator, before):
    """Return the first screenshot that differs from an earlier one; on a busy machine this may take seconds."""
    end = time.monotonic() + LONG / 1000
    while time.monotonic() < end:
        time.sleep(0.1)
        seen = pixels(locator)
        if seen.shape == before.shape and differ(before, seen):
            return seen
    raise AssertionError("the picture stays as it was")


def set_moment(page, value):
    page.locator("#moment").fill(str(value))


def differ(a, b):
    return np.abs(a - b).max() > 0.2 and (np.abs(a - b).max(axis=2) > 0.05).mean() > 0.002


@pytest.mark.parametrize("name", ["plane", "solid"])
def test_the_body_is_drawn_and_follows_its_controls(opened, reports, name):
    page = opened((reports / name / "index.html").as_uri())
    healed = shown(page)
    assert not is_blank(healed)
    assert page.locator('[data-body="A"]').get_attribute("data-drawn") == "upright, healed, displacement"
    set_moment(page, 0)
    page.wait_for_selector('[data-drawn="upright, before surgery, displacement"]')
    shown(page, unlike=healed)
    page.get_by_role("radio", name="supine").check()
    set_moment(page, 3)
    page.wait_for_selector('[data-drawn="supine, healed, displacement"]')
    supine = shown(page, unlike=healed)
    assert "0 to 3.5 mm" in page.locator("[data-body] .said").inner_text()
    page.locator("#colour").select_option("strain_energy_density_kPa")
    page.wait_for_selector('[data-drawn="supine, healed, strain_energy_density_kPa"]')
    shown(page, unlike=supine)


def test_a_body_is_cut_turned_and_compared_with_before(opened, reports):
    page = opened((reports / "solid" / "index.html").as_uri())
    set_moment(page, 1)
    front = shown(page)
    page.get_by_role("button", name="side").click()
    whole = shown(page, unlike=front)
    page.get_by_label("cut open").check()
    cut = shown(page, unlike=whole)
    page.get_by_label("shape before surgery").check()
    shown(page, unlike=cut)
    page.locator("[data-body] .canvas").focus()
    straight = shown(page)
    page.keyboard.press("ArrowRight")
    shown(page, unlike=straight)


def test_a_slider_moves_by_keys_and_says_where_it_is(opened, reports):
    page = opened((reports / "plane" / "index.html").as_uri())
    page.locator("#moment").focus()
    page.keyboard.press("ArrowLeft")
    page.wait_for_selector('[data-drawn="upright, week 2, displacement"]')
    assert page.locator("#moment").get_attribute("aria-valuetext") == "week 2"
    assert page.locator("[data-body] .said").inner_text().startswith("week 2, upright")


def test_slices_are_drawn_and_labels_can_be_taken_off(opened, reports):
    page = opened((reports / "solid" / "index.html").as_uri())
    canvas = page.locator(".slices canvas")
    with_labels = pixels(canvas)
    assert not is_blank(with_labels)
    assert "tumour, excised" in page.locator("[data-slices] .said").inner_text()
    page.locator("#opacity").fill("0")
    page.get_by_label("resection and margin").uncheck()
    changed(canvas, with_labels)
    canvas.focus()
    for _ in range(9):
        page.keyboard.press("PageUp")  # 9 mm upwards, out of the ball of 8
    page.wait_for_selector("[data-slices] .said:has-text('29 mm superior')")
    assert page.locator("[data-slices] .said").inner_text().endswith(": gland.")


def test_curves_and_outlines_are_drawn_with_units_and_come_with_their_data(opened, reports):
    page = opened((reports / "plane" / "index.html").as_uri())
    chart = page.locator('[data-chart="closing"]')
    assert "days after surgery [days]" in chart.locator("svg").last.text_content()
    with page.expect_download() as waiting:
        chart.get_by_role("button", name="Data").click()
    rows = waiting.value.path().read_text(encoding="utf-8").splitlines()
    assert rows[0] == "run,day,open_percent,open_area_mm2"
    assert rows[-1] == "plane,42,0,0"
    with page.expect_download() as waiting:
        page.locator('[data-chart="outline-upright"]').get_by_role("button", name="SVG").click()
    assert waiting.value.path().read_text(encoding="utf-8").count("<path") >= 4 * 40  # four moments, forty edges
    with page.expect_download() as waiting:
        page.locator("[data-body]").get_by_role("button", name="Data").click()
    table = np.genfromtxt(waiting.value.path(), delimiter=",", names=True)
    assert table["displacement"].max() == pytest.approx(7.0, rel=1e-5)  # upright, healed


def test_light_and_dark(opened, reports):
    page = opened((reports / "plane" / "index.html").as_uri(), color_scheme="dark")
    assert pixels(page.locator("header")).mean() < 0.3
    page.get_by_role("button", name="Light").click()
    assert pixels(page.locator("header")).mean() > 0.7


def test_every_control_and_picture_has_a_name(opened, reports):
    for page in (opened((reports / name / "index.html").as_uri()) for name in ("plane", "side")):
        nameless = page.evaluate(
            """() => [...document.querySelectorAll('input, select, button, img, [role="img"], progress')]
                .filter((e) => !(e.labels?.length || e.getAttribute('aria-label') || e.textContent.trim() || e.alt))
                .map((e) => e.outerHTML)"""
        )
        assert nameless == []


def test_the_research_page_draws_every_column(opened, reports):
    page = opened((reports / "solid" / "research.html").as_uri())
    drawn = page.locator("#curves figure[data-drawn]")
    assert drawn.count() == 5  # all columns but time
    assert "something to note" in page.content()


def test_runs_side_by_side_share_slider_camera_and_scale(opened, reports):
    page = opened((reports / "side" / "index.html").as_uri())
    a, b = shown(page, "A"), shown(page, "B")
    assert not is_blank(a)
    height = min(a.shape[0], b.shape[0])
    assert np.abs(a[:height] - b[:height]).mean() < 0.01  # the same shapes from the same viewpoint
    set_moment(page, 0)
    for letter in "AB":
        page.wait_for_selector(f'[data-body="{letter}"][data-drawn="upright, before surgery, displacement"]')
        assert page.locator(f'[data-body="{letter}"] .high').inner_text() == "7"
    page.locator('[data-body="A"] .canvas').focus()
    turned = shown(page, "B")
    page.keyboard.press("ArrowUp")
    shown(page, "B", unlike=turned)


def test_an_unfinished_run_shows_what_there_is(opened, reports):
    page = opened((reports / "stopped" / "index.html").as_uri())
    assert page.locator(".gap").count() == 2
    assert not is_blank(shown(page))


def test_text_of_a_case_does_nothing(opened, tmp_path):
    evil = "<img src=x onerror=alert(1)>"
    folder = write_run(tmp_path / "run-<img src=x onerror=alert(1)>", 2, text=evil)
    write_report(folder, tmp_path / "report")
    for name in ("index.html", "research.html"):
        page = opened((tmp_path / "report" / name).as_uri())
        assert page.locator('img[src="x"]').count() == 0


@pytest.fixture(scope="module")
def planning(tmp_path_factory):
    """Serve a planning page for a coarse phantom; return the server and the folder of its runs."""
    folder = tmp_path_factory.mktemp("planning")
    picture, labels = phantom(spacing_mm=2.5, seed=1)
    write_volume(folder / "breast.nii.gz", picture)
    write_volume(folder / "labels.nii.gz", labels)
    planner = Planner(build_table(folder / "breast.nii.gz", folder / "labels.nii.gz"), folder / "out", folder / "site")
    server = PlanServer(planner)
    Thread(target=server.serve_forever, daemon=True).start()
    yield server, folder / "out"
    planner.job.stop()
    server.shutdown()
    server.server_close()


def test_a_resection_is_planned_run_stopped_gone_on_with_and_reported(opened, planning):
    server, out = planning
    page = opened(server.address, home=server.address)
    page.wait_for_selector("#removed:has-text('ml')")
    assert abs(float(page.locator("#removed").inner_text().split()[0]) - 7.24) < 0.2  # a ball of 12 mm
    page.locator("#radius").fill("6")
    page.wait_for_selector("#removed:has-text('0.9')")  # 0.905 ml
    slices = page.locator(".slices canvas")
    before = pixels(slices)
    x = float(page.locator("#x").input_value())
    page.locator("#x").fill(str(x - 5))
    page.locator("#x").press("Tab")
    changed(slices, before)
    page.get_by_role("button", name="Save").click()
    page.wait_for_selector("#told:has-text('plan-1.toml')")
    assert re.search(rf"centre_mm = \[{x - 5:.1f}", (out / "plan-1.toml").read_text(encoding="utf-8"))
    page.get_by_role("button", name="Start").click()
    page.wait_for_selector("#closed-value:has-text('closed')", timeout=4 * LONG)
    page.get_by_role("button", name="Stop").click()
    page.wait_for_selector("body[data-run='interrupted']", timeout=2 * LONG)
    assert "resumed" in page.locator("#told").inner_text()
    page.get_by_role("button", name="Start").click()
    page.wait_for_selector("body[data-run='finished']", timeout=6 * LONG)
    assert "Resumed after cycle" in (out / "plan-1" / "manifest.json").read_text(encoding="utf-8")
    page.get_by_role("button", name="Report").click()
    page.wait_for_selector("#report-link")
    report = opened(server.address + page.locator("#report-link").get_attribute("href"), home=server.address)
    assert not is_blank(shown(report))
    assert "The wound closed after" in report.content()

"""The explorer in a browser: sliders, keys, wrong input, scenes, files, reload, two widths."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import viscovib as vv

SCENES = Path(__file__).parents[2] / "data" / "scenes"
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
try:
    import bokeh  # noqa: F401
    from playwright.sync_api import sync_playwright
except ImportError as error:
    pytest.skip(f"no browser test: {error.name} is not installed", allow_module_level=True)

pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no browser test: chromium is not installed (apt-get install chromium)"
)

#: y values of the stable curve of the first figure in the page.
CURVE = """() => {
  const all = [...Bokeh.documents[0]._all_models.values()]
  return Array.from(all.filter(m => m.name === 'x: stable').at(-1).data.y)
}"""
#: Milliseconds from a key to the first frame with the new curve.


@pytest.fixture(scope="module")
def browser():
    with sync_playwright() as play:
        shown = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        # One context: the second page uses the compiled scripts of the first.
        yield shown.new_context()
        shown.close()


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """Serve a folder with some scenes by the command."""
    folder = tmp_path_factory.mktemp("scenes")
    for name in ("mount_paper", "mount_branch", "pendulum_paper", "duffing_branch"):
        shutil.copy(SCENES / f"{name}.nml", folder)
    command = [sys.executable, "-m", "viscovib", "explore", "mount_paper.nml", "--no-browser"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, cwd=folder,
        env=os.environ | {"PYTHONUNBUFFERED": "1"},
    ) as server:  # fmt: skip
        yield server.stdout.readline().strip()
        server.terminate()


@pytest.fixture(scope="module")
def opened(browser, address):
    """A page, which takes seconds to open; what it requested; errors of its scripts."""
    shown = browser.new_page()
    shown.set_viewport_size({"width": 1280, "height": 900})
    outside, failed = [], []
    shown.on("request", lambda request: outside.append(request.url))
    shown.on("pageerror", lambda error: failed.append(str(error)))
    open_page(shown, address)
    yield shown, outside, failed
    shown.close()


@pytest.fixture
def page(opened):
    """Reset the page; finally check that it requested nothing from outside and no script failed."""
    shown, outside, failed = opened
    if float(mass(shown).input_value()) != 1:
        shown.get_by_role("button", name="Reset").click()
        reads(shown, 1)
    yield shown
    assert [
        url for url in outside if not url.startswith(("http://127.0.0.1:", "data:", "blob:"))
    ] == []
    assert failed == []


def open_page(page, address):
    page.goto(address)
    page.get_by_role("status").wait_for(timeout=60_000)
    page.locator("canvas").first.wait_for()


def mass(page):
    return page.get_by_role("textbox", name="mass (kg)")


def amplitude(**changes):
    keys = {key.replace("__", "."): value for key, value in changes.items()}
    return vv.run(vv.Scene.read(SCENES / "mount_paper.nml").override(keys)).value.amplitude("x")


def shows(page, want):
    """Wait until the curve equals the result in Python."""
    for _ in range(400):
        found = np.array(page.evaluate(CURVE), dtype=float)
        if found.shape == want.shape and np.array_equal(found, want):
            return
        page.wait_for_timeout(50)
    raise AssertionError("the curve did not become what Python computes")


def reads(page, want):
    """Wait until the field shows this text."""
    for _ in range(200):
        value = float(mass(page).input_value())
        if value == pytest.approx(want, rel=1e-5):
            return value
        page.wait_for_timeout(50)
    raise AssertionError(f"the field says {value}, not {want}")


def test_a_slider_moved_by_keys_moves_the_curve(page):
    shows(page, amplitude())
    page.locator(".noUi-handle").first.focus()
    for k in range(1, 9):
        page.keyboard.press("ArrowRight")
        # The next key waits for this curve, also on a busy machine.
        value = reads(page, 1 + k * 3.75 / 400)
    shows(page, amplitude(mount__mass=value))
    page.get_by_role("button", name="Undo").click()
    page.wait_for_function(
        "([field, was]) => Number(field.value) < was", arg=[mass(page).element_handle(), value]
    )
    # Steps of a quick movement are undone together, and nothing is left to reset.
    page.get_by_role("button", name="Redo").click()
    reads(page, value)
    page.get_by_role("button", name="Reset").click()
    shows(page, amplitude())
    # Sliders have names, also after they were built again.
    slider = page.get_by_role("slider", name="mass (kg)")
    slider.wait_for()
    # The curve arrives before the slider moves back.
    page.wait_for_function(
        "(handle) => Number(handle.getAttribute('aria-valuenow')) === 1",
        arg=slider.element_handle(),
    )
    slider.focus()
    page.keyboard.press("ArrowRight")
    assert page.get_by_role("slider", name="slider", exact=True).count() == 0
    reads(page, 1 + 3.75 / 400)


def test_a_wrong_number_is_reported_with_its_field(page):
    mass(page).fill("-3")
    mass(page).press("Enter")
    message = page.get_by_role("alert")
    message.wait_for()
    assert message.inner_text() == "mass = -3: must be greater than 0"
    field, reported = mass(page).bounding_box(), message.bounding_box()
    assert 0 < reported["y"] - field["y"] < 80
    assert abs(reported["x"] - field["x"]) < 40
    shows(page, amplitude())
    mass(page).fill("2")
    mass(page).press("Enter")
    shows(page, amplitude(mount__mass=2))
    message.wait_for(state="hidden")


def test_reload_and_a_link_restore_the_state(page, browser):
    mass(page).fill("1.75")
    mass(page).press("Enter")
    page.wait_for_url("**mount.mass=1.75")
    link = page.url
    page.reload()
    page.get_by_role("status").wait_for()
    assert mass(page).input_value() == "1.75"
    shows(page, amplitude(mount__mass=1.75))
    other = browser.new_page()
    open_page(other, link)
    assert mass(other).input_value() == "1.75"
    other.goto(link.replace("1.75", "-1"))
    other.get_by_role("alert").wait_for()
    assert "mass = -1: must be greater than 0" in other.get_by_role("alert").inner_text()
    other.close()


def test_files_are_handed_over(page, tmp_path):
    mass(page).fill("1.5")
    mass(page).press("Enter")
    shows(page, amplitude(mount__mass=1.5))
    kept = {}
    for label in ("Table (CSV)", "Picture (PNG)", "Picture (SVG)", "Scene (NML)", "Python lines"):
        with page.expect_download() as waiting:
            page.get_by_role("button", name=label, exact=True).first.click()
        kept[label] = Path(tmp_path / waiting.value.suggested_filename)
        waiting.value.save_as(kept[label])
    assert {path.name for path in kept.values()} == {
        "mount_paper_response.csv", "mount_paper_response.png", "mount_paper_response.svg",
        "mount_paper_explored.nml", "mount_paper_explored.py",
    }  # fmt: skip
    again = vv.run(kept["Scene (NML)"])
    assert np.array_equal(again.value.amplitude("x"), amplitude(mount__mass=1.5))
    again.to_csv(tmp_path / "again.csv")
    rows = (tmp_path / "again.csv").read_text().splitlines()
    assert kept["Table (CSV)"].read_text().splitlines()[5:] == rows[5:]
    assert kept["Picture (PNG)"].read_bytes()[:4] == b"\x89PNG"
    assert "<svg" in kept["Picture (SVG)"].read_text()
    assert "'mount.mass': 1.5" in kept["Python lines"].read_text()


def test_broken_and_other_scenes_and_measured_curves(page, tmp_path):
    page.get_by_role("button", name="Scene", exact=True).click()
    broken = tmp_path / "broken.nml"
    broken.write_text((SCENES / "base_linear.nml").read_text().replace("mass = 1.0", "mass = -1.0"))
    page.locator("input[type=file]").nth(0).set_input_files(broken)
    page.get_by_role("alert").wait_for()
    assert "line 3: mass = -1: must be greater than 0" in page.get_by_role("alert").inner_text()
    shows(page, amplitude())
    page.locator("input[type=file]").nth(0).set_input_files(SCENES / "base_linear.nml")
    with pytest.warns(vv.StabilityWarning):
        want = vv.run(SCENES / "base_linear.nml").value.amplitude("x")
    shows(page, want)
    page.get_by_role("button", name="Compare with a file").click()
    measured = tmp_path / "measured.csv"
    measured.write_text("nu,x\n1,0.01\n2,0.02\n")
    page.locator("input[type=file]").nth(1).set_input_files(measured)
    page.get_by_text("× measured").wait_for()
    measured.write_text("nu\n1\n")
    page.locator("input[type=file]").nth(1).set_input_files(measured)
    page.get_by_role("alert").wait_for()
    assert "one column" in page.get_by_role("alert").inner_text()


@pytest.mark.parametrize(
    ("scene", "widths"),
    [
        ("mount_branch", (1280, 400)),
        ("pendulum_paper", (400, 1280)),
        ("duffing_branch", (1280, 400)),
    ],
)
def test_pages_fit_their_window(browser, address, scene, widths):
    """The window is opened with one width and then changed to the other."""
    shown = browser.new_page()
    shown.set_viewport_size({"width": widths[0], "height": 800})
    open_page(shown, f"{address}?scene={scene}.nml")
    for width in widths:
        shown.set_viewport_size({"width": width, "height": 800})
        shown.wait_for_timeout(300)
        assert shown.evaluate("document.documentElement.scrollWidth") <= width
        keep = os.environ.get("VISCOVIB_SCREENSHOTS")
        if keep:
            shown.screenshot(path=f"{keep}/{scene}_{width}.png", full_page=True)
        # During the animation the curves stay visible near the sliders in a single column.
        before = shown.screenshot()
        shown.get_by_role("button", name="Play").click()
        shown.wait_for_timeout(250)
        shown.get_by_role("button", name="Stop").click()
        assert shown.screenshot() != before
        if width == 400:
            shown.get_by_role("slider").nth(5).scroll_into_view_if_needed()
            box = shown.locator("canvas").first.bounding_box()
            assert box["y"] > -5
            shown.evaluate("window.scrollTo(0, 0)")
    shown.close()

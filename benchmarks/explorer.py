"""Response time of the explorer: from a key on a slider to the new curve."""

import os
import shutil
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

import viscovib as vv
from timing import seconds

Row = dict[str, Any]
SCENES = Path(__file__).parents[1] / "data" / "scenes"
#: Scenes, and the first curve of each figure.
DRAWN = {"mount_paper": "x: stable", "mount_branch": "x: stable"}
KEYS = 40
WATCH = """(name) => {
  window.taken = []
  let pressed = 0
  window.addEventListener('keydown', () => { pressed = performance.now() }, true)
  const all = [...Bokeh.documents[0]._all_models.values()]
  all.filter(m => m.name === name).at(-1).properties.data.change.connect(() =>
    requestAnimationFrame(() => window.taken.push(performance.now() - pressed)))
}"""


def run() -> list[Row]:
    """Return a row per scene: least and median time in the browser, and time of the core alone."""
    from playwright.sync_api import sync_playwright

    found = shutil.which("chromium") or shutil.which("google-chrome")
    if found is None:
        return []
    rows = []
    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=found, args=["--no-sandbox"])
        for name, curve in DRAWN.items():
            path = SCENES / f"{name}.nml"
            taken = latencies(browser, path, curve)
            scene = vv.Scene.read(path)
            rows.append(
                {
                    "scene": name,
                    "least": min(taken),
                    "median": statistics.median(taken),
                    "core": seconds(lambda scene=scene: vv.run(scene)),
                }
            )
        browser.close()
    return rows


def latencies(browser: Any, path: Path, curve: str) -> list[float]:
    """Seconds from each key to the first frame with the new curve."""
    command = [sys.executable, "-m", "viscovib", "explore", str(path), "--no-browser"]
    environment = os.environ | {"PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as server:
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.goto(server.stdout.readline().strip())
        page.get_by_role("status").wait_for(timeout=60_000)
        page.locator("canvas").first.wait_for()
        page.locator(".noUi-handle").first.focus()
        page.evaluate(WATCH, curve)
        for key in range(KEYS):
            page.keyboard.press("ArrowRight" if key < KEYS // 2 else "ArrowLeft")
            # The next key is pressed after the curve of this one, so that times are not mixed.
            page.wait_for_function("count => window.taken.length > count", arg=key)
            page.wait_for_timeout(150)
        taken = page.evaluate("window.taken")
        server.terminate()
    return [time / 1000 for time in taken]

"""Animations: frames, file formats, and refused arguments."""

import re
import shutil
import subprocess

import numpy as np
import pytest
import viscovib as vv
from PIL import Image


@pytest.fixture
def branch(mount):
    return vv.trace_response(mount(0.03), (0.5, 1.5), load=0.1)


def test_a_film_has_its_frames(branch, tmp_path):
    vv.animate(branch, tmp_path / "a.gif", point=3, frames=4, fps=20)
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames == 4
        assert film.info["duration"] == 50
    assert [path.name for path in tmp_path.iterdir()] == ["a.gif"]


def test_a_page_plays_by_itself(branch, tmp_path):
    vv.animate(branch, tmp_path / "a.html", frames=2)
    text = (tmp_path / "a.html").read_text()
    assert text.count("data:image/png;base64") == 2
    assert 'src="http' not in text


def test_the_body_is_where_the_motion_is(branch):
    film = vv.animate(branch, point=5, frames=8)
    scene = film._fig.axes[0]
    (body,) = scene.patches
    _, motion = branch.waveform(5, 8)
    places = []
    for frame in range(8):
        film._func(frame)
        places.append(body.get_xy()[:4, 0].mean())
    factor = float(scene.get_title().split("drawn ")[1].split()[0])
    np.testing.assert_allclose(places, factor * motion[:, 0] / 0.5, atol=1e-12)


def test_a_motion_in_time_is_shown_state_by_state(mount):
    run = vv.simulate(mount(0.03), 5, load=0.1, nu=1.5, dt=0.1)
    film = vv.animate(run, frames=10)
    line = film._fig.axes[1].lines[0]
    assert line.get_xdata().tolist() == run.t[-10:].tolist()


def test_what_cannot_be_shown(branch, mount, tmp_path):
    for arguments, options, message in (
        ((branch, "a.png"), {}, "must end in .gif, .html, .mp4"),
        ((branch,), {"point": 10**6}, "point = 1000000: must be"),
        ((branch,), {"frames": 1}, "frames = 1: must be"),
        ((branch,), {"fps": 0}, "fps = 0: must be"),
        ((3,), {}, "motion = 3: must be a Trajectory"),
        ((vv.simulate(mount(0.03), 5, load=0.1, nu=1.5), None), {"point": 1}, "point: a motion"),
    ):
        with pytest.raises(vv.InputError, match=message):
            vv.animate(*arguments, **options)
    if shutil.which("ffmpeg") is None:
        with pytest.raises(vv.InputError, match="MP4 needs the program ffmpeg"):
            vv.animate(branch, tmp_path / "a.mp4")


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs the program ffmpeg")
def test_every_frame_of_a_film_is_there(branch, tmp_path):
    vv.animate(branch, tmp_path / "a.mp4", point=3, frames=12, fps=6)
    counted = subprocess.run(
        ["ffmpeg", "-i", tmp_path / "a.mp4", "-f", "null", "-"], capture_output=True, text=True
    )
    assert counted.returncode == 0
    assert re.findall(r"frame= *([0-9]+)", counted.stderr)[-1] == "12"

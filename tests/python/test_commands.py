"""The commands sweep and bench, and maps of sweeps."""

import subprocess
import sys
import time
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pytest
import viscovib as vv
import xarray as xr
from processes import end_by_interrupt
from viscovib.cli import bench
from viscovib.cli.commands import main

SCENES = Path(__file__).parents[2] / "data" / "scenes"
PAPER, MAP = SCENES / "mount_paper.nml", SCENES / "mount_map.nml"


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


def small_map(tmp_path, sweeps="&sweep key='load.amplitude', values=0.02 0.04 /\n"):
    text = MAP.read_text()
    scene = tmp_path / "small.nml"
    scene.write_text(
        text[: text.index("&sweep")].replace("nu_count = 200", "nu_count = 20") + sweeps
    )
    return scene


@pytest.mark.parametrize("command", ["sweep", "run", "plot"])
def test_a_scene_with_sweeps_gives_table_picture_and_checkpoint(tmp_path, command, capsys):
    scene = small_map(
        tmp_path,
        "&sweep key='mount.stiffness_x', min=8, max=12, count=3, spacing='log' /\n"
        "&sweep key='load.amplitude', values=0.02 0.04 /\n",
    )
    out = tmp_path / "out"
    assert main([command, str(scene), "--out", str(out), "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    rows = (out / "small_sweep.csv").read_text().splitlines()
    assert rows[1] == "# mount.stiffness_x (N/m), load.amplitude (N)"
    assert rows[2].startswith("mount.stiffness_x,load.amplitude,peak_x,nu_peak_x")
    table = np.loadtxt(rows[3:], delimiter=",")
    assert table.shape == (6, 7)
    data = vv.run(scene).sweep
    assert (data.peak_phi.values.ravel() == table[:, 4]).all()
    np.testing.assert_allclose(data["mount.stiffness_x"], [8, np.sqrt(96), 12], rtol=1e-15)
    assert data.peak_x.attrs["units"] == "m"
    assert (out / "small_sweep.png").read_bytes()[:4] == b"\x89PNG"
    kept = xr.open_zarr(out / "small_sweep.zarr", chunks=None)
    assert (kept.peak_phi.values == data.peak_phi.values).all()
    assert vv.SceneResult.kind.fget(vv.run(scene)) == "sweep"


def test_options_of_the_sweep(tmp_path, capsys):
    out = ["--out", str(tmp_path)]
    over = ["--over", "mount.geometry=exact,cubic", "--over", "load.amplitude=0.01:0.02:2"]
    assert main(["sweep", str(PAPER), *over, *out, "--threads", "1", "--all", "--quiet"]) == 0
    kept = xr.open_zarr(tmp_path / "mount_paper_sweep.zarr", chunks=None)
    assert kept.amplitude.dims == ("mount.geometry", "load.amplitude", "nu", "dof", "harmonic")
    assert main(["sweep", str(PAPER), "--over", "mount.mass=1,-1", *out, "--quiet"]) == 2
    assert "contains another sweep (extract: was all, is summary)" in capsys.readouterr().err
    other = ["--checkpoint", str(tmp_path / "c")]
    assert main(["sweep", str(PAPER), "--over", "mount.mass=1,-1", *out, *other, "--quiet"]) == 2
    assert "at mount.mass = -1.0: InputError: mass = -1: must be" in capsys.readouterr().err
    keep = ["--errors", "keep"]
    assert main(["sweep", str(PAPER), "--over", "mount.mass=1,-1", *out, *other, *keep]) == 1
    assert "1 of 2 points failed" in capsys.readouterr().out
    for bad in ("mount.mass", "mount.mass=1:2", "mount.mass=1:2:1", "=3"):
        assert main(["sweep", str(PAPER), "--over", bad, *out, *other]) == 2
        assert len(capsys.readouterr().err.splitlines()) == 1


def test_ctrl_c_says_how_to_go_on(start, tmp_path):
    scene = small_map(tmp_path, "&sweep key='mount.stiffness_x', min=8, max=12, count=20000 /\n")
    command = [
        sys.executable,
        "-m",
        "viscovib",
        "sweep",
        str(scene),
        "--out",
        str(tmp_path),
    ]
    child = start([*command, "--quiet"], stderr=subprocess.PIPE, text=True)
    outcomes = tmp_path / "small_sweep.zarr" / "point_outcome" / "c"
    deadline = time.monotonic() + 60
    while not outcomes.exists():
        assert child.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.02)
    spent, said = end_by_interrupt(child)
    assert spent < 1
    assert child.returncode == 130
    assert said.splitlines() == [
        f"{outcomes.parents[1]}: contains the finished points, the same command continues "
        "from there",
        "viscovib: interrupted",
    ]


@pytest.mark.parametrize(
    ("group", "message"),
    [
        ("key='mount.stiff', values=1", "key = 'mount.stiff': &mount has no stiff here"),
        ("key='pendulum.e', values=1", "this scene has no &pendulum"),
        ("key='load(2).amplitude', values=1", "this scene has &load 1 times"),
        ("key='load(0).amplitude', values=1", "must be a key in its group"),
        ("key='stiffness', values=1", "must be a key in its group"),
        ("key='sweep.min', values=1", "this scene has no &sweep"),
        ("key='mount.mass', min=1, max=2", "&sweep lacks count"),
        ("key='mount.mass', min=2, max=1, count=3", "max = 1: must be greater than min = 2"),
        ("key='mount.mass', min=1, max=2, count=1", "count = 1: must be 2 to 1000000"),
        ("key='mount.mass', min=0, max=2, count=3, spacing='log'", "greater than 0 with spacing"),
        ("key='mount.mass', values=1, count=3", "count: values lists them already"),
        ("key='mount.mass', values=1, step=3", "unknown key 'step' in &sweep"),
        ("values=1", "&sweep lacks key"),
        ("key='mount.mass', values=1 / &sweep key='Mount.Mass', values=2", "is swept already"),
    ],
)
def test_wrong_sweep_groups_are_reported_with_their_line(tmp_path, group, message):
    scene = small_map(tmp_path, f"&sweep {group} /\n")
    line = scene.read_text()[: scene.read_text().index("&sweep")].count("\n") + 1
    with pytest.raises(vv.InputError) as reported:
        vv.Scene.read(scene)
    assert str(reported.value).startswith(f"{scene}:{line}: ")
    assert message in str(reported.value)


def test_the_plan_counts_the_points(capsys):
    assert main(["plan", str(MAP)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("x load.amplitude (7 values from 0.02 to 0.5) = 231 points, each:")
    assert lines[1].startswith("computes: response at 200 frequencies by method newton")


def test_a_map_shows_what_was_computed():
    data = vv.sweep(lambda a, b: {"y": a * b, "n": int(a > 1)},
                    {"a": [0.0, 1.0, 2.0], "b": [1.0, 2.0]}, progress=False)  # fmt: skip
    ax = vv.plot_map(data, "y")
    mesh = ax.collections[0]
    assert (mesh.get_array().reshape(3, 2) == data.y.values).all()
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("b", "a")
    classes = vv.plot_map(data, "n").collections[0]
    assert classes.cmap.N == 2
    # Each tick is in the middle of its colour, also where 2 is missing between 1 and 4.
    apart = vv.plot_map(xr.DataArray([[0.0, 1.0], [4.0, 1.0]], dims=("a", "b"), name="n"))
    bar = apart.figure.axes[1]
    assert [text.get_text() for text in bar.get_yticklabels()] == ["0", "1", "4"]
    ends = np.asarray(apart.collections[0].norm.boundaries)
    assert bar.get_yticks() == pytest.approx((ends[1:] + ends[:-1]) / 2)
    line = vv.plot_map(data.y.isel(b=1), label="size").lines[0]
    assert (line.get_ydata() == data.y.values[:, 1]).all()
    for wrong, message in (
        ((data,), "name = None: must be one of 'y', 'n'"),
        ((data, "z"), "name = 'z'"),
        ((data.y.expand_dims("c"),), "must be one or two"),
        ((3,), "must be a Dataset"),
    ):
        with pytest.raises(vv.InputError, match=message):
            vv.plot_map(*wrong)


@pytest.mark.filterwarnings("ignore:.*estimated relative error")
def test_the_cost_of_a_scene_and_its_error(capsys):
    nine = vv.Scene.read(SCENES / "mount_resonance.nml").override({"response.harmonics": 9})
    found = bench.measure(nine, runs=3)
    assert [phase.name for phase in found.phases] == ["read", "plan", "compute", "table"]
    assert all(0 < p.best <= p.median and len(p.seconds) == 3 for p in found.phases)
    # Nine harmonics against nineteen, computed separately.
    scene = found.scene
    coarse, fine = (
        vv.run(scene.override({"response.harmonics": n})).response.coefficients for n in (9, 19)
    )
    change = np.abs(fine[:, :, :5] - coarse) / np.abs(fine).max(axis=2, keepdims=True)
    assert found.error == pytest.approx(change.max(), rel=1e-3)
    for name in ("mount_branch", "pendulum_paper", "base_linear"):
        assert main(["bench", str(SCENES / f"{name}.nml"), "--runs", "1"]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert [line.split()[0] for line in lines[2:7]] == [
            "read",
            "plan",
            "compute",
            "table",
            "error",
        ]
    assert "not estimated (linear" in lines[6]
    assert main(["bench", str(PAPER), "--runs", "0"]) == 2
    assert "runs = 0: must be 1 to" in capsys.readouterr().err


def test_a_scene_result_shows_what_was_computed_and_not_the_scene():
    text = repr(vv.run(PAPER))
    assert text.startswith("<SceneResult of mount_paper.nml>\n<Response: 400 of 400")
    assert "&mount" not in text

"""Fitted kernels in scenes: the driver and Python agree at any temperature."""

import json

import numpy as np
import pytest
import viscovib as vv
from rubber_examples import KERNELS, made

SCENE = """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /
&kernel kind='fitted' file='rubber.json' {more}/
&load amplitude=0.1 /
&response nu_from=0.5 nu_to=6 nu_count=40 method='linear' /
{last}
"""
LAWS = {
    "wlf": vv.WLF(reference=20.0, c1=8.86, c2=101.6),
    "arrhenius": vv.Arrhenius(reference=20.0, activation_energy=8e4),
    "table": vv.ShiftTable(temperatures=[-10, 18, 30, 60], decades=[2.5, 0.1, -0.5, -2.2]),
}
SUM = vv.SumKernel(
    parts=[
        KERNELS["rabotnov"],
        vv.PronyKernel(weights=[0.02, 0.01], rates=[1.0, 3.0]),
        vv.TabulatedKernel(times=[0.0, 1.0, 4.0], values=[0.02, 0.01, 0.001]),
    ]
)


def scene(tmp_path, more="", last="", name="scene.nml"):
    path = tmp_path / name
    path.write_text(SCENE.format(more=more, last=last), encoding="utf-8")
    return path


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
@pytest.mark.parametrize("kernel", [*KERNELS.values(), SUM], ids=lambda k: type(k).__name__)
@pytest.mark.parametrize("law", [None, *LAWS])
def test_the_kernel_of_a_scene_is_that_of_the_file(kernel, law, tmp_path):
    written = kernel if law is None else vv.ThermalKernel(kernel=kernel, shift=LAWS[law])
    vv.write_kernel(written, tmp_path / "rubber.json")
    mu = np.geomspace(1e-2, 1e2, 9)
    read = vv.Scene.read(scene(tmp_path)).mount().kernel
    assert read.transform(mu) == pytest.approx(written.transform(mu), rel=1e-14)
    if law is not None:
        warm = vv.Scene.read(scene(tmp_path, "temperature=42.5 ")).mount().kernel
        assert warm.transform(mu) == pytest.approx(written.at(42.5).transform(mu), rel=1e-12)


def test_a_fit_goes_into_a_scene_and_over_temperature(tmp_path):
    fit = vv.fit_kernel(made(KERNELS["rabotnov"], 0.01), shift=LAWS["arrhenius"])
    fit.to_json(tmp_path / "rubber.json")
    last = "&sweep key='kernel.temperature' min=0 max=60 count=3 /"
    path = scene(tmp_path, "temperature=20 ", last)
    found = vv.sweep(path, progress=False)
    for t in (0.0, 30.0, 60.0):
        mount = vv.Mount(
            mass=1,
            inertia=0.1,
            offset=0.5,
            stiffness_x=10,
            stiffness_phi=2,
            kernel=fit.kernel.at(t),
        )
        direct = vv.forced_response(mount, np.asarray(found.nu), load=0.1, method="linear")
        at = np.asarray(found.coefficients.sel({"kernel.temperature": t}))
        assert at == pytest.approx(direct.coefficients, rel=1e-10)


@pytest.mark.parametrize(
    ("content", "more", "reported"),
    [
        ("{", "", "format must be 'viscovib kernel'"),
        ('{"format": "viscovib kernel"}', "", "kernel: must be one with a kind"),
        ('{"format": "viscovib kernel", "kernel": {"kind": "abel", "alpha": 1}}', "", "numbers"),
        (
            '{"format": "viscovib kernel", '
            '"kernel": {"kind": "abel", "amplitude": -1, "alpha": 1}}',
            "", "amplitude = -1",
        ),
        (
            '{"format": "viscovib kernel", "kernel": {"kind": "abel", "amplitude": 1, "alpha": 1}}',
            "temperature=3 ", "no shift law",
        ),
        (
            '{"format": "viscovib kernel", "kernel": {"kind": "abel", "amplitude": 1, "alpha": 1}, '
            '"shift": {"kind": "wlf", "reference": 20, "c1": 9, "c2": 100}}',
            "temperature=-90 ", "temperature: must be one",
        ),
        ('{"format": "viscovib kernel", "kernel": {"kind": "sum", "parts": []}}', "", "kernel"),
        ('{"format": "viscovib kernel", "kernel": ' + "[" * 300, "", "kernel"),
    ],
)  # fmt: skip
def test_bad_files_are_a_line(content, more, reported, tmp_path):
    (tmp_path / "rubber.json").write_text(content)
    with pytest.raises(vv.InputError, match=reported) as caught:
        vv.Scene.read(scene(tmp_path, more))
    assert "\n" not in str(caught.value)
    assert "scene.nml:2" in str(caught.value)


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(vv.ViscovibError, match=r"rubber\.json"):
        vv.Scene.read(scene(tmp_path))


@pytest.mark.filterwarnings("ignore::viscovib.StabilityWarning")
def test_both_readers_take_what_json_writers_vary(tmp_path):
    content = {
        "note": 'a "quoted" } ] text, with \\ and \u00e9', "kernel": {"alpha": 5e-1, "kind": "abel",
        "amplitude": 2}, "format": "viscovib kernel", "version": 1, "rest": [[1, {"kernel": 2}]],
    }  # fmt: skip
    for indent in (None, 3):
        (tmp_path / "rubber.json").write_text(json.dumps(content, indent=indent))
        read = vv.Scene.read(scene(tmp_path)).mount().kernel
        assert read == vv.read_kernel(tmp_path / "rubber.json")
        assert read == vv.AbelKernel(amplitude=2.0, alpha=0.5)

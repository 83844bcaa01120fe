"""Tabulated curves of independent programs (data/README.md), to 1e-10 or better."""

import warnings
from itertools import groupby

import numpy as np
import pytest
import viscovib as vv
from tables import read_table

# Few harmonics are intended here; test_truncation.py tests the warning.
pytestmark = pytest.mark.filterwarnings("ignore:.*estimated relative error")

ORDERS = (1, 3, 5, 7, 9)
OPTIONS = {"harmonics": 9, "tolerance": 1e-14, "max_iterations": 2000}


def numbers(rows, dof, k):
    return np.array([complex(float(r[f"{dof}_{k}_re"]), float(r[f"{dof}_{k}_im"])) for r in rows])


def curves(name, keys):
    """Rows of a table, curve by curve."""
    for values, rows in groupby(read_table(name), key=lambda row: tuple(row[k] for k in keys)):
        rows = list(rows)
        yield values, np.array([float(row["nu"]) for row in rows]), rows


def check(response, rows, orders, tolerance):
    assert response.converged.all()
    assert list(response.harmonics) == list(orders)
    for dof in ("x", "phi"):
        largest = np.abs(numbers(rows, dof, 1))
        for k in orders:
            error = np.abs(response.coefficient(dof, k) - numbers(rows, dof, k)) / largest
            assert error.max() <= tolerance


@pytest.fixture(autouse=True)
def _creep_is_known():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vv.StabilityWarning)
        yield


def test_linear_curves_of_the_paper(mount):
    n = 0
    for (a,), nu, rows in curves("mount_curves.csv", ("A",)):
        r = vv.forced_response(mount(float(a)), nu, load=0.1, method="linear")
        for dof in ("x", "phi"):
            # Near an undamped resonance rounding errors of the input are amplified.
            assert r.coefficient(dof) == pytest.approx(numbers(rows, dof, 1), rel=2e-14)
        n += nu.size
    assert n == 1000


def test_nonlinear_curves_of_the_paper(mount):
    n = 0
    for (geometry, a, load), nu, rows in curves("mount_response_h9.csv", ("geometry", "A", "P")):
        body = mount(float(a), geometry=geometry)
        r = vv.forced_response(body, nu, load=float(load), **OPTIONS)
        check(r, rows, ORDERS, 2e-13)
        n += nu.size
    assert n > 400


def test_two_kernels_and_damping(mount):
    for (geometry,), nu, rows in curves("mount_response_two_kernels.csv", ("geometry",)):
        body = mount(
            kernel_phi=vv.RzhanitsynKernel(amplitude=0.02, alpha=0.3, beta=0.1),
            damping=[[0.2, 0.05], [0.05, 0.03]],
            geometry=geometry,
        )
        r = vv.forced_response(body, nu, load=0.2, **OPTIONS)
        check(r, rows, ORDERS, 2e-13)


def test_full_set_with_a_mean(mount):
    for (geometry,), nu, rows in curves("mount_response_full_set.csv", ("geometry",)):
        r = vv.forced_response(
            mount(geometry=geometry),
            nu,
            load={0: 0.02j, 1: 0.1, 2: 0.03 + 0.01j},
            **OPTIONS,
        )
        check(r, rows, range(10), 2e-13)


def test_natural_frequencies_of_stiff_and_soft_mounts():
    for row in read_table("mount_modes.csv"):
        names = ("mass", "inertia", "offset", "stiffness_x", "stiffness_phi")
        body = vv.Mount(**{name: float(row[name]) for name in names})
        for j, (omega, shape) in enumerate(
            zip(body.natural_frequencies(), body.mode_shapes()[1], strict=True), start=1
        ):
            assert omega == pytest.approx(float(row[f"omega_{j}"]), rel=1e-15)
            assert shape == pytest.approx(float(row[f"a_2{j}"]), rel=4e-15)

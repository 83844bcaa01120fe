"""Very different springs, where rounding errors hide the soft ones: messages as in Python."""

import warnings

import numpy as np
import pytest
import viscovib as vv
from driver import read_csv

WORDS = "rounding hides the soft ones"


def scene_of(kind, mass, stiffness, damping):
    n = mass.size
    numbers = " ".join(f"{k!r}" for k in stiffness.ravel().tolist())
    matrices = f"mass={' '.join(map(repr, mass.tolist()))}\nstiffness={numbers}\n"
    matrices += f"damping={' '.join(f'{c!r}' for c in damping.ravel().tolist())} /\n"
    if kind == "system":
        names = " ".join(f"'x{i + 1}'" for i in range(n))
        text = f"&system coordinates={names}\n{matrices}&force on='x1' law='x1^3' /\n"
    else:
        text = f"&structure size={n}\n{matrices}&element on='x1' law='d^3' /\n"
    return text + "&load on='x1' amplitude=0.1 /\n&response nu=0.5 method='linear' /\n"


@pytest.mark.parametrize("kind", ["system", "structure", "coupled", "follower"])
def test_the_driver_tells_what_python_tells(solve, tmp_path, kind):
    rng = np.random.default_rng(4)
    reported = 0
    path = tmp_path / "scene.nml"
    for i in range(12):
        n = int(rng.integers(2, 6))
        springs = rng.uniform(0.5, 2, n)
        if i % 2:
            top = 14 if kind in ("system", "structure") else 11.5
            springs[rng.integers(1, n)] *= 10 ** rng.uniform(10.5, top)
        stiffness = np.diag(springs + np.append(springs[1:], 0))
        stiffness -= np.diag(springs[1:], 1) + np.diag(springs[1:], -1)
        if kind == "follower":
            stiffness[0, -1] += 0.1
        mass = rng.uniform(0.5, 2, n)
        damping = 0.01 * np.diag(mass)
        if kind == "coupled":
            damping[0, 0] += 0.2
        path.write_text(
            scene_of("system" if kind == "system" else "structure", mass, stiffness, damping)
        )
        run = solve(path, "--plan")
        if kind in ("coupled", "follower") and run.returncode == 2:
            # Refused: no sum over complex modes of so different sizes was found.
            assert "couples modes" in run.stderr
            continue
        assert run.returncode == 0, run.stderr
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            given = {"mass": np.diag(mass), "stiffness": stiffness, "damping": damping}
            if kind == "system":
                vv.PolynomialSystem(**given, forces={"x1": "x1^3"})
            else:
                spring = vv.Spring(on="x1", law="d^3")
                structure = vv.Structure(**given, elements=[spring])
                vv.forced_response(structure, [0.5], load=np.eye(n)[0], method="linear")
        wanted = any(WORDS in str(w.message) for w in seen)
        assert (WORDS in run.stderr) == wanted, run.stderr
        assert run.stderr.count("warning:") == wanted
        reported += wanted
    assert 0 < reported < 7


def test_damping_that_couples_is_refused_with_what_is_true(solve, tmp_path):
    """Springs with a ratio of 1e15 are not coincident modes; rounding makes them appear so."""
    scene = tmp_path / "scene.nml"
    scene.write_text(
        "&structure mass=1 2 1 stiffness=1e15 -1e15 0 -1e15 1e15 -1 0 -1 1\n"
        "  damping=0.1 0 0 0 0.05 0 0 0 0.1 /\n"
        "&element on='x3' law='0.7*d^3' kernel=0 /\n&load on='x1' amplitude=0.5 /\n"
        "&response nu_from=1 nu_to=2 points=3 /\n"
    )
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 2
    assert "or of so different stiffness that rounding makes them so" in done.stderr


@pytest.mark.parametrize("between", [0.0, 0.15])
def test_weak_dampers_with_a_strong_one(solve, tmp_path, between):
    """They are not rounding errors: correct results, or a refusal where they couple modes."""
    path = tmp_path / "scene.nml"
    for strong in (1e3, 1e11, 1e13):
        damping = np.diag([0.2, 0.3, strong])
        damping[0, 1] = damping[1, 0] = between
        path.write_text(
            scene_of("structure", np.ones(3), np.diag([1.0, 2.0, 1e4]), damping)
            .replace("d^3", "1e-9*d^3")
            .replace("nu=0.5", "nu=1.1")
        )
        run = solve(path, "--out", tmp_path)
        if between and strong > 1e10:
            assert run.returncode == 2
            assert "damping: couples" in run.stderr
            continue
        assert run.returncode == 0, run.stderr
        lines = (tmp_path / "scene_response.csv").read_text().splitlines()
        names, row = (line.split(",") for line in lines if not line.startswith("#"))
        found = [
            float(row[names.index(f"{x}_1_re")]) + 1j * float(row[names.index(f"{x}_1_im")])
            for x in ("x1", "x2")
        ]
        dynamic = np.diag([1.0, 2]) + 1.1j * damping[:2, :2] - 1.21 * np.eye(2)
        assert found == pytest.approx(np.linalg.solve(dynamic, [0.1, 0]), rel=1e-12)


@pytest.mark.parametrize("kind", ["none", "dampers"])
def test_soft_motions_with_stiff_elements(solve, tmp_path, kind):
    """Sums of springs and elements keep their rounding errors, as in Python."""
    rng = np.random.default_rng(9)
    for i in range(4):
        n = int(rng.integers(2, 5))
        soft, weak = rng.normal(size=(2, n, n))
        stiffness, mass = soft @ soft.T + 0.2 * np.eye(n), rng.uniform(0.5, 2, n)
        damping = 0.02 * weak @ weak.T * (kind == "dampers")
        high, on = float(10 ** rng.uniform(5, 8)), rng.normal(size=n)
        start = np.linalg.solve(stiffness + high * np.outer(on, on), rng.normal(size=n))
        initial = np.column_stack([start, 0 * start]).ravel()

        def reported(numbers):
            return " ".join(map(repr, np.ravel(numbers).tolist()))

        names = " ".join(f"'x{j + 1}'" for j in range(n))
        path = tmp_path / f"stiff{i}.nml"
        path.write_text(
            f"&structure size={n} mass={reported(mass)} stiffness={reported(stiffness)}\n"
            f"damping={reported(damping)} /\n"
            f"&element on={names} weights={reported(on)} stiffness={high!r} /\n"
            f"&transient t_end=8 keep='last' coordinates={names} initial={reported(initial)} /\n"
        )
        done = solve(path, "--out", tmp_path)
        assert done.returncode == 0, done.stderr
        error = float(done.stdout.split("estimated error")[1])
        run = vv.simulate(
            vv.Structure(
                mass=np.diag(mass), stiffness=stiffness, damping=damping,
                elements=[vv.Spring(on=on, stiffness=high)],
            ),
            8, initial=initial, keep="last",
        )  # fmt: skip
        table = read_csv(tmp_path / f"stiff{i}_transient.csv")
        found = [float(table[f"x{j + 1}{dot}"]) for j in range(n) for dot in ("", "_dot")]
        assert np.abs(run.state[0] - found).max() <= run.error + error

"""Motors and run-ups of scenes: the tables of the driver are the motions of Python."""

import numpy as np
import pytest
import viscovib as vv
from driver import check_refused, read_csv


def row(values):
    return " ".join(repr(float(value)) for value in np.ravel(values))


class Rotor:
    """A random rotor as a scene and in Python, with a law, and perhaps with memory."""

    def __init__(self, kind, seed):
        rng = np.random.default_rng(seed)
        n = self.n = int(rng.integers(2, 9))
        a, b, skew = rng.normal(size=(3, n, n)) / np.sqrt(n)
        given = dict(
            mass=a @ a.T + np.eye(n), stiffness=20 * b @ b.T + 50 * np.eye(n),
            damping=np.diag(rng.uniform(0.3, 0.8, n)), gyroscopic=0.2 * (skew - skew.T),
            circulatory=0.2 * rng.normal(size=(n, n)), centrifugal=0.02 * rng.normal(size=(n, n)),
        )  # fmt: skip
        self.names = [f"x{i + 1}" for i in range(n)]
        keys = "\n".join(f"{name} = {row(value)}" for name, value in given.items())
        names = " ".join(f"'{name}'" for name in self.names)
        keys += "\nkernel = 0" if kind == "system" and seed % 2 else ""
        self.text = f"&{kind} coordinates={names}\n{keys} /\n"
        kernel = vv.PronyKernel(weights=[0.3], rates=[1.5]) if seed % 2 else None
        if kernel is not None:
            self.text += "&kernel kind='prony' weights=0.3 rates=1.5 /\n"
        if kind == "system":
            spring = np.diag(rng.uniform(1, 9, n))
            self.text += "&force on='x1' law='30*x1^3 + 0.1*tanh(x2_dot)' kernel=0 /\n"
            self.text += f"&spring stiffness={row(spring)} kernel={seed % 2} /\n"
            self.system = vv.PolynomialSystem(
                forces={"x1": "30*x1^3 + 0.1*tanh(x2_dot)"},
                springs=[vv.Springs(stiffness=spring, kernel=kernel)], names=self.names, **given,
            )  # fmt: skip
        else:
            self.text += "&element on='x1' law='30*d^3 + 0.1*tanh(v)' kernel=0 /\n"
            self.text += f"&element on='x1' 'x2' stiffness=5 kernel={seed % 2} /\n"
            elements = [
                vv.Spring(on="x1", law="30*d^3 + 0.1*tanh(v)"),
                vv.Spring(on=("x1", "x2"), stiffness=5, kernel=kernel),
            ]
            self.system = vv.Structure(elements=elements, names=self.names, **given)
        self.size, self.phase = rng.uniform(0, 0.03, n), rng.uniform(0, 6, n)
        self.unbalance = self.size * np.exp(1j * self.phase)
        self.start = 0.01 * rng.normal(size=2 * n)


def solved(solve, tmp_path, text):
    scene = tmp_path / "rotor.nml"
    scene.write_text(text)
    done = solve(scene, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    return scene, read_csv(tmp_path / "rotor_transient.csv")


def check(table, run, names):
    for i, name in enumerate([*names, "angle"]):
        for column, key in ((2 * i, name), (2 * i + 1, f"{name}_dot")):
            wanted = run.state[:, column]
            assert np.abs(table[key] - wanted).max() <= 1e-8 * np.abs(wanted).max()


@pytest.mark.parametrize(("kind", "seed"), [("system", 0), ("structure", 3)])
def test_motors_have_the_motion_of_python(solve, tmp_path, kind, seed):
    rotor = Rotor(kind, seed)
    text = f"""&parameters drive=2 /
{rotor.text}
&load on='x2' amplitude=0.3 /
&drive_torque torque='drive - 0.1*nu + 0.2*SIN(phi)' inertia=0.4 unbalance={row(rotor.size)}
  unbalance_phase={row(rotor.phase)} speed=3 phase=0.4 /
&transient t_end=2 times=0 0.7 2 nu=4 initial={row(rotor.start)} acceleration='yes' /
"""
    scene, table = solved(solve, tmp_path, text)
    drive = vv.DriveTorque(
        torque="2 - 0.1*nu + 0.2*sin(phi)", inertia=0.4, unbalance=rotor.unbalance, speed=3,
        phase=0.4,
    )  # fmt: skip
    run = vv.simulate(
        rotor.system, 2, force=drive, times=[0, 0.7, 2], load={"x2": 0.3}, nu=4.0,
        initial=rotor.start,
    )  # fmt: skip
    check(table, run, rotor.names)
    for i, name in enumerate([*rotor.names, "angle"]):
        wanted = run.acceleration[:, i]
        found = table[f"{name}_ddot"]
        assert np.abs(found - wanted).max() <= 1e-6 * np.abs(wanted).max()
    if kind == "system" and seed < 2:
        again = vv.run(scene).trajectory
        assert np.abs(again.state - run.state).max() <= 1e-9 * np.abs(run.state).max()


@pytest.mark.parametrize(("kind", "seed"), [("system", 1), ("structure", 2)])
def test_run_ups_have_the_motion_of_python(solve, tmp_path, kind, seed):
    rotor = Rotor(kind, seed + 10)
    begin = (0.5, -1.0, -9.0)[seed]
    keys = f"kind='unbalance' shape='run_up' speed=3 9 duration=2 hold=8 start={begin}"
    loads = "".join(
        f"&load {keys} on='{name}' amplitude={size!r} phase={phase!r} /\n"
        for name, size, phase in zip(
            rotor.names, rotor.size.tolist(), rotor.phase.tolist(), strict=True
        )
    )
    text = f"{rotor.text}{loads}&transient t_end=3 times=0 1 3 initial={row(rotor.start)} /\n"
    scene, table = solved(solve, tmp_path, text)
    load = vv.RunUp(
        unbalance=rotor.unbalance * np.exp(-1j * rotor.phase[0]), phase=rotor.phase[0],
        speed=(3, 9), duration=2, hold=8, start=begin,
    )  # fmt: skip
    run = vv.simulate(rotor.system, 3, force=load, times=[0, 1, 3], initial=rotor.start)
    check(table, run, rotor.names)
    if kind == "system":
        again = vv.run(scene).trajectory
        assert np.abs(again.state - run.state).max() <= 1e-9 * np.abs(run.state).max()


BODY = """&body mass=10 inertia=0.2 0.3 0.4 rotor=0.05 0 0 /
&mount_point name='a' position=0.3 0.2 -0.1 stiffness=2e3 2.5e3 3e3 damping=20 20 20 /
&mount_point name='b' position=0.3 -0.2 -0.1 stiffness=2e3 2.5e3 3e3 damping=20 20 20 /
&mount_point name='c' position=-0.3 0.1 -0.2 stiffness=2e3 2.5e3 3e3 damping=20 20 20 /
&drive_torque torque='0.8 - 0.02*nu' inertia=0.06 unbalance=0 0.1 0.1 0.01 0 0 /
"""


def test_a_motor_on_a_body_has_the_motion_of_python(solve, tmp_path):
    text = BODY + "&transient t_end=2 times=0 2 /\n"
    _, table = solved(solve, tmp_path, text)
    body = vv.Scene.read(tmp_path / "rotor.nml").body()
    drive = vv.DriveTorque(
        torque="0.8 - 0.02*nu", inertia=0.06, unbalance=[0, 0.1, 0.1, 0.01, 0, 0]
    )
    run = vv.simulate(body, 2, force=drive, times=[0, 2])
    check(table, run, body.dof_names)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (BODY.replace("rotor=0.05 0 0", "geometry='exact'") + "&transient t_end=1 /",
         "needs a &system"),
        (BODY + "&transient t_end=1 forces='yes' /", "forces = 'yes': must be 'no'"),
        (BODY.replace("0.02*nu", "0.02*q") + "&transient t_end=1 /", "torque = "),
        (BODY.replace("0.06", "1e-9") + "&transient t_end=1 /", "must be greater than"),
        (BODY + "&load kind='acceleration' shape='step' amplitude=1 on='x' /\n"
         "&transient t_end=1 /", "must not be given together with"),
        ("&mount mass=1 inertia=1 offset=0 stiffness_x=1 stiffness_phi=1 /\n"
         "&drive_torque torque='1' inertia=1 /\n&transient t_end=1 /", "&drive_torque"),
        (BODY + "&modes /", "&drive_torque: needs &transient"),
        ("&system coordinates='x' mass=1 stiffness=1 circulatory=1 /\n"
         "&load kind='unbalance' shape='run_up' amplitude=1 duration=1 speed=1 2 /\n"
         "&load kind='unbalance' shape='run_up' amplitude=1 duration=1 speed=1 3 /\n"
         "&transient t_end=1 /", "must be the same in all run-ups"),
    ],
)  # fmt: skip
def test_what_a_motor_cannot_be_is_refused(solve, tmp_path, text, says):
    check_refused(solve, tmp_path, f"{text}\n", says)

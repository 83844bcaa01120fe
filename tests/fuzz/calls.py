"""Random calls of the public Python API, as texts.

Names, signatures (with overloads) and allowed words are read from the package, so that new
functions are included. `SOUND` contains valid calls. A random call is one of them with some
arguments changed, or a call created from a signature.
"""

import inspect
import random
import re
import typing
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import viscovib as vv

PENDULUM = "vv.Pendulum(e=0.1, w2=0.4, w3=0.8, c1=0.05, c2=0.05, c3=0.05, f0=0.01, p1=0.9)"
FREE = "vv.Pendulum(e=0.1, w2=0.4, w3=0.8)"
KERNEL = "vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)"
MOUNT = (
    "vv.Mount(mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2, "
    "damping=[[0.2, 0], [0, 0.1]])"
)
MEMORY = MOUNT.replace("damping", f"kernel={KERNEL}, damping")
SYSTEM = "vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces='x^3', names=('x',))"
RUN = f"vv.simulate({PENDULUM}, t_end=20, dt=0.25, initial=[0.05, 0, 0.3, 0, -0.2, 0])"
RESPONSE = (
    f"vv.forced_response(system={MOUNT}, nu=[1, 2, 3], load=0.1, method='newton', harmonics=3)"
)
STEADY = f"vv.forced_response({PENDULUM}, p1=[0.8, 0.9], harmonics=3)"
BRANCH = (
    f"vv.trace_response(system={SYSTEM}, nu_range=(0.8, 1.6), load=0.2, harmonics=3, max_points=80)"
)
DRIVEN = f"vv.trace_response({PENDULUM}, p1=(0.85, 0.95), harmonics=3, max_points=20)"
SCALES = f"vv.MultipleScales({PENDULUM})"
ENSEMBLE = (
    f"vv.simulate_ensemble({PENDULUM}, initial=[[0.05, 0, 0.3, 0, -0.2, 0]], t_end=5, dt=0.25)"
)
SCENE = "vv.Scene.read('scene.nml')"
DATA = (
    "vv.ModulusData(frequencies=[1, 10, 100, 1e3, 1e4, 1e5], "
    "storage=[1.1, 1.3, 1.7, 2.1, 2.5, 2.7], "
    "loss=[0.1, 0.2, 0.3, 0.35, 0.3, 0.2])"
)
SETS = (
    "vv.ModulusData(frequencies=[1, 2, 4, 1, 2, 4], storage=[1.5, 2, 3, 1, 1.4, 2], "
    "loss=[1, 1, 1, 1, 1, 1], temperature=[10, 10, 10, 30, 30, 30])"
)
FIT = f"vv.fit_kernel({DATA}, kind='rabotnov')"
SIGNAL = "np.cos(0.3 * np.arange(200.0))"

#: Files that calls may read, in the working folder.
FILES = {
    "modes.nml": """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /
&modes /
""",
    "scene.nml": """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /
&load amplitude=0.1 /
&response nu_from=0.5 nu_to=4 nu_count=4 method='linear' /
""",
    "pendulum.nml": """&pendulum e=0.1 w2=0.4 w3=0.8 c1=0.01 f0=0.005 p1=0.93 /
&transient initial=0.05 0 0.3 0 -0.2 0 t_end=5 dt=0.25 /
&spectrum window='hann' discard=1 /
""",
    "mass.mtx": "%%MatrixMarket matrix coordinate real general\n2 2 2\n1 1 1.0\n2 2 2.0\n",
    "stiffness.mtx": "%%MatrixMarket matrix coordinate real symmetric\n2 2 2\n1 1 3.0\n2 2 1.0\n",
    "dma.csv": "f,E',E''\nHz,MPa,MPa\n1,2,1\n2,3,1\n4,4,1\n",
    "mount.csv": "f;K*;angle\nHz;N/mm;deg\n1;2,5;10\n2;3;20\n",
    "time.csv": "t,E\ns,MPa\n1,3\n2,2\n4,1\n",
    "creep.csv": "t,J\ns,1/MPa\n1,3\n2,4\n4,5\n",
    "kernel.json": '{"format": "viscovib kernel", "version": 1, '
    '"kernel": {"kind": "abel", "amplitude": 0.1, "alpha": 0.3}}',
    "fit.json": (
        '{"format": "viscovib kernel", "version": 1, "kernel": {"kind": "rabotnov", '
        '"amplitude": 7.90441, "alpha": 0.338592, "beta": 10.6401}, "modulus": '
        '3.42065, "quantity": "E", "kind": "rabotnov", "parameters": {"modulus": '
        '3.42065, "amplitude": 7.90441, "alpha": 0.338592, "beta": 10.6401}, '
        '"interval": {"modulus": [3.28637, 3.56041], "amplitude": [6.81421, 9.16903], '
        '"alpha": [0.313385, 0.364811], "beta": [9.07158, 12.4798]}, "weights": '
        '"model", "shares": [1.0, 1.0], "optima": [{"cost": 0.0233373, "parameters": '
        '{"modulus": 3.40936, "amplitude": 7.90198, "alpha": 0.338175, "beta": '
        '10.6339}}], "fit": {"parts": ["rabotnov"], "allow_creep": false, '
        '"given_modulus": null, "unit": 0.00316228, "unknowns": [1.22983, -0.699555, '
        '-6.98372, 1.06105]}, "data": {"kind": "modulus", "frequencies": [1.0, 10.0, '
        '100.0, 1000.0, 10000.0, 100000.0], "storage": [1.1, 1.3, 1.7, 2.1, 2.5, '
        '2.7], "loss": [0.1, 0.2, 0.3, 0.35, 0.3, 0.2], "temperature": null, "set": '
        '[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "amplitude": null, "quantity": "E"}}'
    ),
    "law.csv": "0,0.2\n1,0.1\n2,0.05\n",
    "body.nml": "&system coordinates='x' mass=1 stiffness=1 damping=0.1 /\n"
    "&kernel kind='tabulated' file='law.csv' /\n&force law='tanh(x) - x' /\n"
    "&load amplitude=0.1 /\n&response nu=0.5 1 harmonics=3 /\n",
}

#: Readers of files: a call for each kind, and the files that it reads.
READERS = (
    ("vv.read_fit('fit.json')", ("fit.json",)),
    ("vv.read_fit('fit.json').interval", ("fit.json",)),
    ("vv.read_kernel('kernel.json')", ("kernel.json",)),
    ("vv.read_kernel('fit.json')", ("fit.json",)),
    ("vv.read_dma('dma.csv')", ("dma.csv",)),
    ("vv.read_dynamic_stiffness('mount.csv')", ("mount.csv",)),
    ("vv.read_relaxation('time.csv')", ("time.csv",)),
    ("vv.read_creep('creep.csv')", ("creep.csv",)),
    ("vv.Structure.read('mass.mtx', 'stiffness.mtx')", ("mass.mtx", "stiffness.mtx")),
    ("vv.Scene.read('body.nml')", ("body.nml", "law.csv")),
    ("vv.run('body.nml')", ("body.nml", "law.csv")),
    ("vv.run('pendulum.nml')", ("pendulum.nml",)),
)

LAYERED = (
    "vv.simulate(vv.Structure(mass=[1, 2], stiffness=[[2, -1], [-1, 2]], "
    f"layers=[([[1, 0], [0, 0.5]], {KERNEL})], elements=[vv.Spring(on='x2', law='d^3')]), 5, "
    "load={'x1': 0.1}, nu=1.0)"
)
STRUCTURE = (
    "vv.Structure(mass=[1, 2, 1], stiffness=[[2, -1, 0], [-1, 2, -1], [0, -1, 1]], "
    "modal_damping=0.02, elements=[vv.Spring(on='x3', law='0.1*d^3')])"
)
HUNG = (
    "vv.Structure(mass=[1, 2, 1], stiffness=[[2, -1, -1], [-1, 2, -1], [-1, -1, 2]], "
    "supports=['x3'], base_direction=[1.0], elements=[vv.Spring(on=('x1', 'x3'), law='0.1*d^3')])"
)
CHAIN = (
    "vv.Structure(mass=[1] * 40, stiffness=sparse.diags_array([-1.0, 2, -1], "
    "offsets=[-1, 0, 1], shape=(40, 40)), rayleigh=(0.01, 0.01), "
    "elements=[vv.Spring(on='x30', law='0.1*d^3')])"
)
SMALL = f"{CHAIN}.reduce(frequency=0.5, tolerance=1e-4, loads=['x1'])"
#: Valid calls with a short run time.
FOOT = (
    "vv.MountPoint(name='foot', position=[0, 0.1, -0.1], stiffness=[1e5, 1e5, 2e5], "
    "angles=[0, 0.1, 0], damping=[1, 1, 1], law='1e10*d^3', rotational_stiffness=[1e3, 1e3, 1e3])"
)
BODY = f"vv.Body(mass=10, inertia=[0.2, 0.2, 0.3], mounts=[{FOOT}], gravity=9.81)"
#: Laws with functions, with and without memory, on coordinates and between points.
STOP = (
    "vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, "
    "forces='0.2*tanh(3*x) + where(x > 0.5, (x - 0.5)^2, 0)', names=('x',))"
)
ROTOR = (
    "vv.PolynomialSystem(mass=[1, 2], stiffness=[1, 2], damping=[0.3, 0.3], "
    "gyroscopic=[[0, 0.5], [-0.5, 0]], circulatory=[[0, 0.2], [-0.2, 0]], centrifugal=[0, 0.1], "
    "forces={'x1': 'x1^3'})"
)
HELD = (
    "vv.Structure(mass=[1, 2, 1], stiffness=[[2, -1, 0], [-1, 2, -1], [0, -1, 1]], "
    "modal_damping=0.02, elements=[vv.Spring(on='x3', stiffness=0.2, law='0.1*sinh(d)', "
    f"kernel={KERNEL}), vv.Coupling(on={{'a': 'x1', 'b': ('x1', 'x3')}}, "
    "law={'a': 'k*a*b^2', 'b': 'k*a^2*b'}, parameters={'k': 0.5})])"
)
SOUND = (
    STOP, HELD,
    "vv.Coupling(on={'a': 'x1', 'b': ('x1', 'x2')}, law={'a': 'k*a*b^2'}, parameters={'k': 1.0})",
    f"vv.trace_response({STOP}, nu_range=(0.8, 1.6), load=0.3, harmonics=5, max_points=80)",
    f"vv.simulate({STOP}, t_end=5, dt=0.1, initial=[0.1, 0])",
    f"vv.forced_response({HELD}, nu=[0.4, 0.5], load={{'x1': 0.01}}, harmonics=3, "
    "method='newton', stability=True)",
    f"vv.backbone({STRUCTURE}, mode=0, amplitude_range=(0.01, 0.5), harmonics=3, max_points=40)",
    f"{HELD.replace('modal_damping=0.02', 'rayleigh=(0.01, 0.01)')}.characteristic_roots(count=2)",
    f"vv.simulate({STRUCTURE}, t_end=5, dt=0.1, initial=[0.1, 0, 0, 0, 0, 0])",
    f"vv.trace_response({BODY}, (15.0, 25.0), load=[0, 0, 10, 0, 0, 0], harmonics=3, "
    "max_points=60)",
    f"vv.simulate({BODY}, t_end=0.1, dt=0.001, initial=[0, 0, 1e-3, 0, 0, 0] + [0] * 6)",
    f"vv.simulate({BODY}, t_end=0.1, dt=0.005, initial=[0, 0, 1e-3, 0, 0, 0] + [0] * 6)"
    ".mount_forces()",
    f"vv.simulate({BODY}, t_end=0.1, dt=0.005, initial=[0, 0, 1e-3, 0, 0, 0] + [0] * 6)"
    ".floor_force(about=[0, 0, 0.1])",
    f"vv.simulate({BODY}, t_end=0.1, dt=0.005, initial=[0, 0, 1e-3, 0, 0, 0] + [0] * 6)"
    ".motion_of(point='foot', relative=True)",
    f"vv.simulate({STRUCTURE}, t_end=5, dt=0.1, initial=[0.1, 0, 0, 0, 0, 0]).element_forces()",
    f"vv.simulate({HUNG}, t_end=5, dt=0.1, base=0.1, nu=1.0).support_reactions()",
    f"vv.simulate({STOP}, t_end=5, dt=0.1, initial=[0.1, 0]).peak(quantity='x_ddot')",
    f"vv.plot_energy(modes={BODY}.modes())",
    f"vv.plot_transmissibility(body={BODY}, hz=[5.0, 10.0], axis='z')",
    f"vv.plot_van_gurp(data={DATA})",
    "vv.plot_sections(quantity='phi', "
    f"ensemble={ENSEMBLE.replace('t_end=5', 'sections=1, t_end=20')})",
    f"vv.animate({RUN}, frames=3)",
    "vv.read_fit(path='fit.json')",
    FOOT, BODY, f"{BODY}.modes()", f"{BODY}.sag()",
    "vv.FluidTrack(mass=60, damping=2000, stiffness=4e5)",
    f"{BODY}.mount_forces(vv.forced_response({BODY}, [20.0], load=[0, 0, 1, 0, 0, 0]))",
    f"vv.report({BODY}, 'body.html')", f"vv.plot_body({BODY}, mode=1, torque_about='y')",
    f"{BODY}.random_floor(hz=[1.0, 2.0], density=[1.0, 1.0])",
    f"{BODY}.engine_orders(speeds=[10.0], orders=[1.0], loads=[[0, 0, 1, 0, 0, 0]])",
    PENDULUM, KERNEL, MOUNT, MEMORY, SYSTEM, RUN, RESPONSE, STEADY, BRANCH, DRIVEN, SCALES,
    ENSEMBLE, SCENE,
    'vv.simulate(vv.PolynomialSystem(mass=1, stiffness=1, forces="3*max(x - 0.2, 0)"), 4, '
    'initial=[0.1, 0.5], events=[vv.Event("x - 0.1", direction="up"), "x_dot"])(1.5)',
    f"vv.steady_motion({SYSTEM}, nu=0.8, load=0.2)",
    f"vv.trace_motion({SYSTEM}, (0.7, 0.8), load='0.3*nu^2', max_step=0.2, max_points=50)",
    f"vv.steady_motion({STOP}, 0.9, load=0.3, initial=[0.1, 0], n_periods=2).extremes('x')",
    'vv.basins(vv.PolynomialSystem(mass=1, stiffness=-1, damping=0.3, forces="x^3"), '
    '{"x": [0.5, -0.5], "x_dot": [0.1, 0.2]}, t_end=20, dt=0.1)',
    'vv.simulate_ensemble(vv.PolynomialSystem(mass=1, stiffness=1, forces="tanh(x)"), '
    'initial=[[0.1, 0.2]], t_end=5, dt=0.25, load=0.5, nu=1.2, lyapunov="all")',
    "vv.AbelKernel(amplitude=0.05, alpha=0.3)",
    "vv.SumKernel(parts=[vv.AbelKernel(amplitude=0.05, alpha=0.3)])",
    DATA, SETS, FIT, STRUCTURE, LAYERED, CHAIN, SMALL,
    "vv.Spring(on={'x1': 1, 'x2': -1}, stiffness=1, damping=0.1, law='k*d^3', parameters={'k': 2})",
    "vv.Spring(on='x1', stiffness=1, law='k*v*abs(v) + tanh(v/0.1)', parameters={'k': 2})",
    "vv.FluidDamper(on='x1', coefficient=2, exponent=0.3)",
    "vv.FluidDamper(on='x1', coefficient=2, exponent=0.3).force([0.1, -0.2])",
    "vv.FluidDamper(on='x1', coefficient=2, exponent=0.3).energy([0.1, 0.2], nu=3.0)",
    "vv.FluidDamper(on='x1', coefficient=2, exponent=2, limit=3, relief=0.1).energy(2, nu=3.0)",
    "vv.StribeckFriction(on='x1', coulomb=1, static=2, velocity=0.1, exponent=2, width=0.01)",
    "vv.StribeckFriction(on='x1', coulomb=1, static=2, velocity=0.1).energy([0.1, 0.2], nu=3.0)",
    "vv.plot_loop(vv.BoucWen(on='x1', stiffness=20, beta=5, gamma=-7), 0.3, nu=2.0)",
    "vv.Maxwell(on='x1', stiffness=20, coefficient=2, exponent=2.0)",
    "vv.Maxwell(on='x1', stiffness=20, coefficient=2, exponent=0.5).energy([0.1, 0.2], nu=3.0)",
    "vv.Maxwell(on='x1', stiffness=20, coefficient=2, exponent=0.5).loop(0.1, nu=3.0)",
    "vv.Jenkins(on='x1', stiffness=20, limit=1)",
    "vv.Iwan(on='x1', stiffness=[20, 10], limit=[1, 2])",
    "vv.BoucWen(on='x1', stiffness=20, ratio=0.1, beta=5, gamma=2, exponent=2)",
    "vv.Dahl(on='x1', stiffness=20, limit=1, exponent=2)",
    "vv.Gap(on='x1', stiffness=20, gap=0.5)",
    "vv.Stop(on='x1', stiffness=20, gap=0.5, exponent=1.5)",
    f"{CHAIN}.reduce(frequency=0.5, loads=['x1'], method='craig-bampton', "
    "lowest=0.1, max_modes=50)",
    f"{CHAIN}.characteristic_roots(count=2)",
    f"{STRUCTURE}.write(path='out.npz')",
    f"{SMALL}.write(path='out.mtx', coordinates=['x1'])",
    f"{SMALL}.in_modes()",
    f"{SMALL}.in_modes().load(load={{'x1': 0.1}})",
    f"{SMALL}.in_modes().start(displacements=[0.01] * 40, velocities=[0.0] * 40)",
    "vv.Structure.read(mass='mass.mtx', stiffness='stiffness.mtx', modal_damping=0.1)",
    f"vv.forced_response({SMALL}, nu=[0.1, 0.2], load={{'x1': 0.01}}, coordinates=['x1', 'x9'])",
    f"vv.trace_response({STRUCTURE}, (0.3, 0.6), load={{'x1': '0.01*nu^2'}}, harmonics=3)",
    f"vv.forced_response({SMALL}, nu=[0.1], load={{'x1': 0.01}}).check(points=1)",
    "vv.read_dma(path='dma.csv')",
    "vv.read_dynamic_stiffness(path='mount.csv')",
    "vv.read_relaxation(path='time.csv', ramp=0.5)",
    "vv.read_creep(path='creep.csv')",
    "vv.RelaxationData(times=[1, 2, 4], modulus=[3, 2, 1])",
    "vv.CreepData(times=[1, 2, 4], compliance=[1, 2, 3])",
    f"vv.kramers_kronig(data={DATA})",
    f"vv.master_curve(data={SETS}, reference=20)",
    "vv.fit_shift_law(temperatures=[0, 20, 50], decades=[2, 0, -2], reference=20)",
    "vv.ShiftTable(temperatures=[0, 20, 50], decades=[2, 0, -2])",
    f"vv.fit_kernel(data={DATA}, kind='prony', terms=5)",
    f"vv.propagate(fit={FIT}, function=lambda s: s.modulus, samples=5)",
    f"vv.prony_terms(source={KERNEL}, modulus=2e6, t_min=1e-3, t_max=10, tolerance=0.05)",
    "vv.read_kernel(path='kernel.json')",
    "vv.jenkins_stiffness([1e-3, 2e-3], stiffness=1e5, slip=1e-3)",
    "vv.fit_progressive(deflection=[0, 1, 2, 3], force=[0, 1, 3, 7], degree=3)",
    "vv.fit_amplitude(vv.ModulusData(frequencies=[1, 10, 100, 1, 10, 100], "
    "storage=[3, 4, 5, 2, 3, 4], "
    "loss=[1, 1, 1, 1, 1, 1], amplitude=[1, 1, 1, 2, 2, 2], quantity='K'))",
    f"vv.write_kernel(kernel={KERNEL}, path='out.json')",
    f"{FIT}.profile('alpha')",
    f"{FIT}.to_json(path='out.json')",
    f"vv.plot_modulus(data={DATA})",
    f"vv.plot_cole_cole(data={DATA})",
    f"vv.plot_nomogram(master=vv.master_curve({SETS}, reference=20))",
    "vv.WLF(reference=20, c1=8.86, c2=101.6)",
    "vv.Arrhenius(reference=20, activation_energy=8e4)",
    f"vv.ThermalKernel(kernel={KERNEL}, shift=vv.WLF(reference=20, c1=8.86, c2=101.6)).at(40)",
    "vv.RabotnovKernel(amplitude=0.05, alpha=0.3, beta=1)",
    "vv.PronyKernel(weights=[0.1, 0.2], rates=[0.5, 3])",
    "vv.TabulatedKernel(times=[0, 1, 2], values=[0.2, 0.1, 0.05], interpolation='linear')",
    f"{KERNEL}.sum_of_exponentials(tolerance=1e-6, t_min=0.01, t_max=10)",
    "vv.Pendulum.from_physical(m=1, I_A=0.2, E=0.1, L0=0.5, k1=100, Omega1=3, F1=0.1)",
    "vv.CubicSystem(mass=[[1]], stiffness=[[1]], damping=[[0.1]], cubic=[[[[0.5]]]], "
    "load=[[0.1]], drives=[1])",
    "vv.LoadTable(times=[0, 1, 2], values=[0, 1, 0])",
    "vv.HalfSine(amplitude=1.0, duration=0.1, start=0.5)",
    "vv.Haversine(amplitude=1.0, duration=0.1)",
    "vv.Sawtooth(amplitude=[1.0, 2.0], duration=0.1)",
    "vv.Trapezoid(amplitude=1.0, duration=0.1, rise=0.02, fall=0.01)",
    "vv.Chirp(amplitude=1.0, duration=1.0, hz=[1.0, 5.0], sweep='linear')",
    "vv.PistonEngine(crank_radius=0.05, rod_length=0.2, reciprocating_mass=1, crank_angles=[0, 3], "
    "positions=[0, 1], bank_angles=0.5, rotating_mass=[1, -1], axis='y', up='z', at=[0, 0, 1], "
    "strokes=4, firing_order=[1, 2], pressure=([0, 3, 9], [1e5, 0, 1]), bore=0.1, highest=6)",
    "vv.PistonEngine(crank_radius=0.05, rod_length=0.2, reciprocating_mass=1, crank_angles=[0], "
    f"positions=[0], gas_torque={{0.5: 30j, 1: 2}}).load({BODY}, per='cycle')",
    "vv.RunUp(unbalance=[0.1, 0.1j], speed=(0, 5), duration=2.0, hold=1.0, phase=0.3)",
    "vv.DriveTorque(torque='5 - 0.1*nu', inertia=0.5, unbalance=[0.1, 0.1j], speed=1, phase=0.3)",
    f"vv.simulate({SYSTEM}, t_end=1, force=vv.DriveTorque(torque='1', inertia=1, unbalance=0.1))",
    "vv.Step(amplitude=1.0, start=0.5, unit='g')",
    f"vv.simulate({MOUNT}, t_end=1, dt=0.1, base_acceleration=vv.Step(amplitude=1.0))",
    "vv.Past(times=[-1, 0], displacements=[[0, 0], [0.1, 0]])",
    "vv.Monomial(coefficient=1, powers=[3], on='x')",
    "vv.Springs(stiffness=1)",
    f"vv.simulate({MOUNT}, t_end=5, initial=[0.1, 0, 0, 0])",
    f"vv.simulate({MEMORY}, t_end=2, dt=0.1, held=[0.1, 0])",
    f"vv.simulate({SYSTEM}, t_end=5, dt=0.1, load='0.2*nu^2*exp(0.1j*nu)', nu=1.2, tolerance=1e-6)",
    f"vv.backbone({SYSTEM}, mode=0, amplitude_range=(0.01, 0.5), harmonics=3)",
    f"vv.backbone({FREE}, mode=1, energy_range=(1e-4, 1e-3), harmonics=3, max_points=20)",
    f"vv.plan_response(system={MOUNT}, nu=[1, 2], load=0.1)",
    f"vv.campbell(system={ROTOR}, speeds=[0, 1, 2, 3], orders=[1, 2], plane=('x1', 'x2'))",
    f"vv.plot_campbell(diagram=vv.campbell({ROTOR}, [0, 1, 2, 3]))",
    f"vv.trace_response({ROTOR}, nu_range=(0.5, 1.5), load=[0.1, 0], harmonics=3, max_points=50)",
    f"vv.simulate({ROTOR}, t_end=5, load=[0.1, 0], nu=1.2, tolerance=1e-6)",
    f"{ROTOR}.at_speed(speed=1.5)",
    f"{ROTOR[:-1]}, speed=2.0).characteristic_roots()",
    f"vv.spectrum(signal={SIGNAL}, dt=0.1, window='hann')",
    f"vv.shock_response_spectrum(record={SIGNAL}, frequencies=[0.1, 2], dt=0.1, damping=0.05)",
    f"vv.amplitudes_at(signal={SIGNAL}, dt=1, frequencies=[0.3])",
    f"vv.dominant_frequencies(signal={SIGNAL}, dt=1, count=1)",
    "vv.fourier_coefficients(samples=[0, 1, 0, -1], orders=1)",
    f"vv.free_decay(trajectory=vv.simulate({SYSTEM}, t_end=60, dt=0.1, initial=[0.1, 0]), count=1)",
    "vv.name_frequencies(frequencies=[1, 2], bases={'p1': 1.0}, order=3)",
    "vv.plan(scene='scene.nml')",
    "vv.run(scene='scene.nml')",
    "vv.run(scene='modes.nml').value",
    "vv.run(scene='pendulum.nml')",
    "vv.sweep(lambda a: {'y': a * a}, grid={'a': [1.0, 2.0]}, progress=False, n_threads=1)",
    "vv.sweep('scene.nml', grid={'mount.mass': [1, 2]}, progress=False, n_threads=1)",
    "vv.plot_map(vv.sweep(lambda a, b: {'y': a * b}, grid={'a': [1.0, 2.0], 'b': [1.0, 2.0]}, "
    "progress=False, n_threads=1), name='y')",
    f"vv.plot_response(response={RESPONSE})",
    f"vv.plot_branch(branch={BRANCH})",
    f"vv.plot_trajectory(trajectory={RUN})",
    f"vv.plot_spectrum(spectrum=vv.spectrum({SIGNAL}, 0.1))",
    f"vv.plot_backbone(backbone=vv.backbone({SYSTEM}, 0, (0.01, 0.5), harmonics=3))",
    f"vv.plot_scales_response(response={SCALES}.response('p1', [0.8, 0.9]))",
    f"vv.plot_modulation(motion={SCALES}.motion([0, 1], [0.05, 0, 0.1, 0, 0.1, 0]))",
    f"{SCALES}.response('p1', [0.8, 0.9])",
    f"{SCALES}.motion([0, 1, 2], [0.05, 0, 0.1, 0, 0.1, 0])",
    "vv.MultipleScales(vv.Pendulum(e=0.0102, w2=0.366, w3=0.988, alpha=0.573, c1=0.0258, "
    "c2=0.00555, c3=0.00837, f0=0.0046, m01=0.00058, m02=0.0017, p1=1.01, p2=1.0086, p3=0.3595))"
    ".response('p1', [1.01]).beating(0)",
    f"{SCALES}.modulation([0, 1, 2], [0.05, 0, 0.1, 0, 0.1, 0])",
    f"{MEMORY}.characteristic_roots()",
    f"{MOUNT}.modes()",
    f"vv.trace_response({SYSTEM}, nu=0.5, load_range=(0, 10), load=1, harmonics=5, "
    "symmetric=False, max_points=200)",
    f"{SCALES}.resonances(tolerance=0.9)",
)  # fmt: skip

#: Functions that start a server, which would continue after the call.
SERVERS = ("Explorer", "explore")

#: Valid values for required arguments of methods.
GIVEN = {
    "t": "[0.5, 1, 2]", "mu": "[0.5, 1]", "s": "1 + 1j", "nu": "[1, 2]", "dof": "'x'",
    "state": "[0.05, 0, 0.3, 0, -0.2, 0]", "path": "'out.csv'", "tolerance": "1e-6",
    "t_min": "0.01", "t_max": "10", "values": "[0.8, 0.9]", "i": "0", "harmonic": "1",
    "initial": "[0.05, 0, 0.1, 0, 0.1, 0]", "name": "'phi'", "index": "0", "n": "16",
    "parameter": "'p1'",
}  # fmt: skip

#: Invalid values, and values at the limits of number ranges.
NASTY = (
    "nan", "inf", "-inf", "1e308", "-1e308", "1.7e308", "1e-308", "5e-324", "1e-320", "0", "0.0",
    "-0.0", "-1", "-1.5", "1", "2", "7", "1e5", "1e9", "1e12", "1e-12", "1e150", "1e-150", "1e199",
    "(2**31 - 1)", "2**31", "-2**31", "(2**63)", "(2**70)", "10**400", "1e300", "1j",
    "complex('nan')",
    "True", "False", "None", "np.True_", "'x'", "''", "'auto'", "'phi'", "'e'", "'p1'", "'a\\nb'",
    "'\\x00'", "'\\ud800'", "'caf\u00e9'", "'x' * 5000", "b'x'", "b'\\xff'", "[]", "()", "{}",
    "set()", "{1, 2}", "[1]", "[1, 2]", "[2, 1]", "(0.5, 1)", "(1, 1)", "[1, 2, 3]",
    "[[1, 2], [3]]",
    "[[1, 2], [3, 4]]", "[None]", "['x']", "['x', 'phi']", "[[]]", "{'a': 1}", "{1: 0.1}",
    "{0: 0.1}", "{1: [0.1, 0]}", "{-1: 1}", "{'x': 'y'}", "{None: None}", "np.zeros(0)",
    "np.zeros((0, 3))", "np.zeros((0, 6))", "np.zeros(6)", "np.zeros((2, 2, 2))", "np.ones((3, 3))",
    "np.array(1.0)", "np.array([True, False])", "np.array(['a'])", "np.array([None, 1])",
    "np.float32(0.1)", "np.int8(3)", "np.longdouble('1e4000')", "np.datetime64('2020')",
    "np.ma.masked_array([1.0, 2.0], mask=[True, False])", "np.ma.masked", "np.array([1, nan])",
    "np.array([1, inf])", "np.array([1e308, 1e308])", "np.arange(6.0)[::-1]", "np.eye(6)[::2]",
    "np.full(3, 1e-320)", "object()", "int", "len", "lambda *a, **k: 1", "lambda: 1 / 0",
    "(i for i in range(3))", "range(3)", "range(10**9)", "Fraction(1, 3)", "Decimal('0.1')",
    "Decimal('nan')", "Path('x')", "Ellipsis", "slice(1)", "xr.Dataset()", "xr.DataArray([1, 2])",
    "np.matrix([[1, 2], [3, 4]])", "np.broadcast_to(1.0, (3,))", "memoryview(b'ab')",
    "float('1e-5')", "nested", "Odd()", "Liar()",
)  # fmt: skip
_NUMBERS = ("0.1", "0.5", "1", "2", "3", "0.01", "1e-6", "10", "0.9", "5", "1.5")
_WHOLE = ("0", "1", "2", "3", "5", "9", "-1", "16", "100")
#: Attributes that identify a result.
_OF_RESULTS = ("plan", "outcome", "coefficients")
#: Systems and results, also passed to arguments of another type.
_OBJECTS = (PENDULUM, MOUNT, MEMORY, SYSTEM, KERNEL, RUN, RESPONSE, BRANCH, SCALES, SCENE)


@dataclass(frozen=True)
class Callee:
    """A callable: ``text`` up to the parenthesis, and its parameters."""

    text: str
    parameters: tuple[inspect.Parameter, ...]
    words: tuple[str, ...]
    #: Class whose object ``this`` must be; "" for functions and constructors.
    of: str = ""


@dataclass
class Api:
    """The public API, and the expressions that create objects of each class."""

    callees: list[Callee] = field(default_factory=list)
    #: Names of the public classes that have methods or properties.
    classes: dict[str, type] = field(default_factory=dict)


def public() -> Api:
    """Read the package."""
    api = Api()
    for name in vv.__all__:
        if name in SERVERS:
            continue
        value = getattr(vv, name)
        if inspect.isclass(value) and issubclass(value, (BaseException, Warning)):
            continue
        api.callees += _callees(f"vv.{name}", value)
        if inspect.isclass(value):
            api.classes[name] = value
            api.callees += _methods(name, value)
    return api


def _callees(text: str, value: Any, of: str = "") -> Iterator[Callee]:
    words = tuple(dict.fromkeys(re.findall(r'"(\w+)"', inspect.getdoc(value) or "")))
    forms: list[Callable[..., Any]] = list(typing.get_overloads(value)) or [value]
    for form in forms:
        try:
            parameters = list(inspect.signature(form).parameters.values())
        except (ValueError, TypeError):
            continue
        results = any(p.name.startswith("_") or p.name in _OF_RESULTS for p in parameters)
        if inspect.isclass(value) and results:
            # Created by the package only.
            continue
        if of and parameters and parameters[0].name == "self":
            parameters = parameters[1:]
        yield Callee(text, tuple(parameters), words, of)


def _methods(name: str, kind: type) -> Iterator[Callee]:
    for member in dir(kind):
        if member.startswith("_") and member != "__call__":
            continue
        found = inspect.getattr_static(kind, member)
        if isinstance(found, (classmethod, staticmethod)):
            yield from _callees(f"vv.{name}.{member}", getattr(kind, member))
        elif inspect.isfunction(found):
            call = "this" if member == "__call__" else f"this.{member}"
            yield from _callees(call, found, name)
        elif isinstance(found, property) or type(found).__name__ == "cached_property":
            yield Callee(f"this.{member}", (), (), name)


def is_property(api: Api, callee: Callee) -> bool:
    """True if the callee is a property."""
    if not callee.of or callee.text == "this":
        return False
    found = inspect.getattr_static(api.classes[callee.of], callee.text.partition(".")[2])
    return not inspect.isfunction(found)


class Caller:
    """Creates random calls."""

    def __init__(self, makers: dict[str, list[str]]) -> None:
        """``makers``: for each class expressions that create objects."""
        self.api, self.makers = public(), makers
        self.methods = [c for c in self.api.callees if c.of and c.of in makers]
        self.others = [c for c in self.api.callees if not c.of]
        self.sound = [split(text) for text in SOUND]

    def call(self, rng: random.Random) -> str:
        """Return the text of a call: one line, or two for a method."""
        draw = rng.random()
        if draw < 0.45:
            return self._changed(rng)
        callee = rng.choice(self.methods if draw < 0.85 else self.others)
        lines = []
        if callee.of:
            lines.append(f"this = {rng.choice(self.makers[callee.of])}")
        if is_property(self.api, callee):
            lines.append(callee.text)
        else:
            lines.append(f"{callee.text}({self._arguments(rng, callee)})")
        return "\n".join(lines)

    def _arguments(self, rng: random.Random, callee: Callee) -> str:
        given = []
        strange = rng.random() < 0.75
        for p in callee.parameters:
            if p.kind in (p.VAR_KEYWORD, p.VAR_POSITIONAL):
                continue
            if p.default is not p.empty and rng.random() < 0.7:
                continue
            text = GIVEN.get(p.name)
            if text is None or (strange and rng.random() < 0.5):
                text = self.value(rng, p, callee.words, text)
            given.append(text if p.kind == p.POSITIONAL_ONLY else f"{p.name}={text}")
        return ", ".join(given)

    def _changed(self, rng: random.Random) -> str:
        """A valid call with some arguments changed, added or omitted."""
        name, given = rng.choice(self.sound)
        if name is None:
            return str(given)
        arguments = dict(given)
        forms = [c for c in self.others if c.text == name]
        known = {p.name: p for form in forms for p in form.parameters}
        words = forms[0].words if forms else ()
        for _ in range(rng.choice([1, 1, 1, 2, 2, 3])):
            draw = rng.random()
            if draw < 0.6 or not known:
                key = rng.choice(sorted(arguments))
                arguments[key] = self.value(rng, known.get(key), words, arguments[key])
            elif draw < 0.95:
                key = rng.choice(sorted(known))
                if known[key].kind in (
                    inspect.Parameter.VAR_KEYWORD,
                    inspect.Parameter.VAR_POSITIONAL,
                ):
                    continue
                if known[key].kind is not inspect.Parameter.KEYWORD_ONLY and any(
                    k.startswith("*") for k in arguments
                ):
                    continue
                arguments[key] = self.value(rng, known[key], words, arguments.get(key))
        inside = ", ".join(v if k.startswith("*") else f"{k}={v}" for k, v in arguments.items())
        return f"{name}({inside})"

    def value(
        self,
        rng: random.Random,
        parameter: inspect.Parameter | None,
        words: tuple[str, ...],
        before: str | None,
    ) -> str:
        """A value for an argument, of its type or of another type."""
        kind = "" if parameter is None else str(parameter.annotation)
        draw = rng.random()
        if draw < 0.45:
            return rng.choice(NASTY)
        if draw < 0.5:
            return rng.choice(_OBJECTS)
        if before is not None and draw < 0.75:
            return _number_changed(rng, before)
        if "str" in kind and words and draw < 0.85:
            return repr(rng.choice(words))
        if "bool" in kind:
            return rng.choice(["True", "False"])
        if "'int'" in kind or kind.startswith("int"):
            return rng.choice(_WHOLE)
        if "tuple[float, float]" in kind:
            return f"({rng.choice(_NUMBERS)}, {rng.choice(_NUMBERS)})"
        if "ArrayLike" in kind or "Buffer" in kind:
            n = rng.choice([1, 2, 3, 6])
            return f"[{', '.join(rng.choice(_NUMBERS + NASTY[:35]) for _ in range(n))}]"
        return rng.choice(_NUMBERS)


def split(text: str) -> tuple[str | None, Any]:
    """Name and arguments of a call; positional arguments have names that begin with a star."""
    import ast

    tree = ast.parse(text, mode="eval").body
    if not isinstance(tree, ast.Call):
        # An attribute of a result: unchanged.
        return None, text
    arguments = {f"*{i}": ast.unparse(arg) for i, arg in enumerate(tree.args)}
    arguments |= {str(k.arg): ast.unparse(k.value) for k in tree.keywords}
    if not arguments:
        return None, text
    return ast.unparse(tree.func), arguments


def _number_changed(rng: random.Random, before: str) -> str:
    """Replace one of the numbers in a text."""
    found = list(re.finditer(r"(?<![\w.'])\d+(\.\d*)?(e-?\d+)?(?![\w.'])", before))
    if not found:
        return rng.choice(NASTY)
    here = rng.choice(found)
    new = rng.choice(NASTY[:35] if rng.random() < 0.5 else _NUMBERS)
    return f"{before[: here.start()]}{new}{before[here.end() :]}"

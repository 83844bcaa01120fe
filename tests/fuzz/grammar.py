"""The grammar of scenes, derived from messages of the driver.

Groups, their keys and the allowed words of a key are read from the messages in which the driver
refuses unknown names, so that new keys are included.
"""

import json
import re
import subprocess
import tempfile
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
SCENES = ROOT / "data" / "scenes"

#: A scene as a list of groups, each with its name and its keys and values as text.
Scene = list[tuple[str, dict[str, str]]]

#: A fast scene for each kind of job.
SEEDS = {
    "ensemble": """&system coordinates='x' mass=1 stiffness=-1 damping=0.3 /
&force on='x' law='x^3' /
&load on='x' amplitude=1 /
&ensemble vary='load_scale' from=0.2 to=0.35 count=3 nu=1.2 initial=0.1 0.2 sections=1
  n_periods=6 discard=2 dt=0.1 lyapunov='yes' coordinates='x' tolerance=1e-6 method='dop8' /
""",
    "ensemble_of_pendulums": """&pendulum e=0.1 w2=0.4 w3=0.8 alpha=0.5 f0=0.002 p1=1.02 /
&ensemble vary='f0' from=0.001 to=0.004 count=4 initial=0 0 0.1 0 0 0 t_end=5 discard=1
  rtol=1e-5 atol=1e-9 amplitudes_at=0.4 1.02 sample_every=2 /
""",
    "ensemble_one_by_one": """&structure mass=1 1 stiffness=2 -1 -1 2 damping=0.1 0.1 /
&kernel weights=0.2 rates=1 kind='prony' /
&element on='x1' stiffness=0.5 law='k3*d^3' kernel=1 /
&element on='x2' stiffness=0.2 /
&parameters k3=0.6 /
&load on='x1' amplitude=0.3 /
&ensemble vary='k3' from=0.2 to=0.35 count=3 nu=1.2 initial=0.1 0.2 0 0 sections=1
  n_periods=3 discard=1 dt=0.1 coordinates='x1' method='gauss8' /
""",
    "ensemble_at_corners": """&system coordinates='x' mass=1 stiffness=1 damping=0.1 /
&force on='x' law='8*max(x - 0.1, 0)' /
&load on='x' amplitude=0.3 /
&ensemble vary='nu' from=0.7 to=1.2 count=3 initial=0.1 0.2 t_end=5 discard=1 tolerance=1e-5 /
""",
    "basins": """&system coordinates='x' mass=1 stiffness=-1 damping=0.3 /
&force on='x' law='x^3' /
&load on='x' amplitude=0.2 /
&basins vary='x' 'x_dot' from=-1 -1 to=1 1 count=2 3 nu=1.2 n_periods=12 initial=0 0 dt=0.1
  max_period=2 tolerance=1e-3 coordinates='x' /
""",
    "many_orders": """&system coordinates='x' mass=1 stiffness=1 damping=0.1 /
&force law='0.1*x^3' /
&load amplitude=0.3 /
&load order=230 amplitude=0.3 /
&response nu=0.7 method='newton' harmonics=231 /
""",
    "modes": """&system coordinates='x' 'y' mass=1 2 stiffness=2 -1 -1 2 /
&modes coordinates='y' /
""",
    "response": """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /
&kernel kind='rzhanitsyn' amplitude=0.048 alpha=0.1 beta=0.05 /
&load amplitude=0.1 /
&response nu_from=0.5 nu_to=4 nu_count=6 /
""",
    "newton": """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10
  stiffness_phi=2 damping=0.1 0 0 0.1 /
&kernel kind='prony' weights=0.1 0.2 rates=0.5 3 acts_on='x' /
&load amplitude=0.1 phase=0.3 /
&load order=0 amplitude=0.05 on='phi' /
&response nu=1 2 3 method='newton' harmonics=5 stability='yes' /
""",
    "branch": """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /
&kernel kind='abel' amplitude=0.05 alpha=0.3 /
&load amplitude='0.02*nu^2' /
&branch nu_from=1 nu_to=4 harmonics=3 max_points=60 /
""",
    "load_branch": """&system coordinates='x' mass=1 stiffness=1 damping=0.1 /
&force law='x^3' /
&load amplitude=0.3 /
&branch vary='load_factor' nu=1.3 from=0 to=2 harmonics=3 max_points=60 /
""",
    "system": """&system coordinates='x1' 'x2' mass=1 1 stiffness=2 -1 -1 2 damping=0.02 0.02 /
&kernel kind='tabulated' times=0 1 2 values=0.2 0.1 0.05 /
&spring stiffness=1 0 kernel=1 /
&force on='x2' law='0.5*(x1 - x2)^3' kernel=0 /
&load on='x1' amplitude=0.3 /
&response nu_from=0.3 nu_to=2 nu_count=5 harmonics=3 /
""",
    "parameters": """&parameters k3=0.5 f0=0.02 soft=0.1 /
&system coordinates='x1' 'x2' mass=1 1 stiffness=2 -1 -1 2 damping=0.02 0.02 /
&force on='x2' law='k3*(x1 - x2)^3' /
&force on='x1' law='f0*tanh(x1_dot/soft)' /
&load on='x1' amplitude='f0*nu^2/sqrt(1 + soft*nu)' phase='0.1*nu' /
&response nu_from=0.3 nu_to=2 nu_count=3 harmonics=5 method='newton' sampling='yes'
  dissipation='yes' /
""",
    "motor": """&system coordinates='x1' 'x2' mass=1 1 stiffness=100 90 circulatory=0 0.1 -0.1 0 /
&drive_torque torque='2 - 0.1*nu + 0.1*sin(phi)' inertia=0.4 unbalance=0.02 0.01
  unbalance_phase=0 1 speed=3 phase=0.1 /
&transient t_end=1 /
""",
    "body": """&body mass=10 inertia=0.3 0.01 0 0.01 0.2 0 0 0 0.4 gravity=0 0 -9.81 /
&kernel kind='prony' weights=0.3 rates=1.5 /
&mount_point name='a' position=0.1 0.2 0 stiffness=1e4 1e4 2e4 angles=0 0.1 0 kernel=1 /
&mount_point name='b' position=-0.1 0.1 0 stiffness=1e4 1e4 2e4 law_z='1e8*d^3' kernels=0 0 1 /
&mount_point name='c' position=0 -0.2 0.1 stiffness=1e4 1e4 2e4 damping=1 2 3
  rotational_stiffness=1 1 1 /
&load on='z' amplitude=5 /
&branch nu_from=20 nu_to=30 harmonics=3 max_points=20 stability='no' /
""",
    "body_fluid": """&body mass=10 inertia=0.3 0.2 0.4 base_direction=0 0 1 0 0 0 /
&mount_point name='a' position=0.1 0.2 0 stiffness=1e4 1e4 2e4 track=1 20 5e3 track_axis='z' /
&mount_point name='b' position=-0.1 0.1 0 stiffness=1e4 1e4 2e4 /
&mount_point name='c' position=0 -0.2 0.1 stiffness=1e4 1e4 2e4 /
&load kind='base' amplitude=0.001 /
&response nu_from=20 nu_to=60 nu_count=6 method='linear' /
""",
    "body_exact": """&body mass=10 inertia=0.3 0.2 0.4 geometry='exact' load_axes='body' /
&mount_point name='a' position=0.1 0.2 0 stiffness=1e4 1e4 2e4 damping=10 10 10 /
&mount_point name='b' position=-0.1 0.1 0 stiffness=1e4 1e4 2e4 damping=10 10 10 /
&mount_point name='c' position=0 -0.2 0.1 stiffness=1e4 1e4 2e4 damping=10 10 10 /
&load on='ry' amplitude=1 /
&load on='x' amplitude=1e-4 kind='unbalance' /
&response nu=30 method='newton' harmonics=3 /
""",
    "body_motion": """&body mass=10 inertia=0.3 0.2 0.4 /
&mount_point name='a' position=0.1 0.2 0 stiffness=1e2 1e2 2e2 damping=10 10 10 /
&mount_point name='b' position=-0.1 0.1 0 stiffness=1e2 1e2 2e2 law_x='1e3*d^3' /
&mount_point name='c' position=0 -0.2 0.1 stiffness=1e2 1e2 2e2 /
&transient initial=0.01 0 0 0 0 0 0 0 0 0 0 0 t_end=2 tolerance=1e-5 /
""",
    "structure": """&structure size=3 mass=1 1 1 stiffness=2 -1 0 -1 2 -1 0 -1 2 rayleigh=0.02 0.01
  shapes=1 0 0 0 0 1 /
&kernel kind='prony' weights=0.3 rates=1.5 /
&element on='x1' 'x2' weights=1 -1 stiffness=0.4 law='0.5*d^3' kernel=1 /
&element on='x2' damping=0.1 law='tanh(d)' kernel=0 /
&load on='x1' amplitude='0.2*exp(nu - 1)' /
&branch nu_from=0.6 nu_to=0.9 harmonics=3 max_points=40 /
""",
    "layers": """&structure size=3 mass=1 1 1 stiffness=2 -1 0 -1 2 -1 0 -1 2 rayleigh=0.02 0 /
&kernel kind='prony' weights=0.3 rates=1.5 /
&layer stiffness=1 0.5 0 0.5 1 0 0 0 0.2 kernel=1 /
&element on='x2' law='0.5*d^3' kernel=0 /
&load on='x1' amplitude=0.2 /
&response nu=0.6 0.9 method='newton' harmonics=3 /
""",
    "structure_modes": """&structure mass=1 2 stiffness=2 3 base_direction=1 1 units='m' 'm'
  coordinates='x' 'y' modal_damping=0.1 /
&modes coordinates='x' /
""",
    "structure_response": """&structure mass=1 2 stiffness=2 3 loss_factor=0.1 /
&element on='x1' law='d^3' /
&load amplitude=0.1 /
&response nu=1 2 method='newton' harmonics=3 stability='yes' /
""",
    "mount_motion": """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /
&kernel kind='rabotnov' amplitude=0.05 alpha=0.3 beta=1 /
&transient held=0.1 0 t_end=5 dt=0.1 /
&spectrum discard=1 /
&event function='x' direction='down' terminal='yes' /
""",
    "system_motion": """&system coordinates='x' mass=1 stiffness=1 damping=0.1 /
&force coefficient=1 powers=3 /
&load amplitude=0.3 /
&transient initial=0.1 0 nu=1.2 t_end=10 tolerance=1e-6 times=0.3 4 9.5 /
""",
    "shock": """&system coordinates='x' 'y' mass=1 2 stiffness=3 -1 -1 3 base_direction=1 1 /
&load kind='acceleration' shape='trapezoid' amplitude=2 unit='g' duration=0.1 rise=0.02 fall=0.03 /
&load kind='acceleration' shape='record' times=0 0.1 0.3 values=1 2 0 amplitude=3 /
&load shape='chirp' amplitude=3 duration=0.2 hz=5 20 sweep='logarithmic' start=0.1 on='y' /
&load shape='step' amplitude=1 /
&load kind='unbalance' shape='run_up' amplitude=1 speed=0 9 duration=0.5 hold=0.2 phase=1 on='y' /
&transient t_end=1 dt=0.02 acceleration='yes' /
&shock_spectrum coordinate='y' frequencies=1 20 300 damping=0.1 kind='pseudo_velocity' /
""",
    "structure_shock": """&structure mass=1 2 stiffness=3 2 damping=1 1 base_direction=1 1 /
&element on='x1' law='d^3' /
&load kind='acceleration' shape='record' file='k.csv' unit='g' /
&load shape='half_sine' amplitude=1 duration=0.3 on='x2' /
&transient t_end=2 tolerance=1e-6 /
&shock_spectrum file='k.csv' from=1 to=20 count=5 spacing='linear' /
""",
    "law": """&system coordinates='x' 'y' mass=1 0.1 stiffness=1.2 -0.2 -0.2 0.2
  damping=0.03 -0.01 -0.01 0.01 /
&kernel kind='rzhanitsyn' amplitude=0.048 alpha=0.1 beta=0.05 /
&force on='x' law='0.5*x*(1 + tanh((x^2 - 0.25)/0.1))' /
&force on='y' law='where(y > 0.1, sin(y) - 0.3*exp(-y^2), max(x, y, 0))' kernel=1 /
&load on='x' amplitude=0.15 /
&response nu_from=0.5 nu_to=1.9 nu_count=4 harmonics=3 stability='yes' /
""",
    "law_motion": """&system coordinates='x' mass=1 stiffness=1 damping=0.1 /
&force law='abs(x)*x + log(1 + x^2)/sqrt(2 + cos(x))' /
&load amplitude=0.3 /
&transient initial=0.1 0 nu=1.2 t_end=10 dt=0.1 /
""",
    "pendulum": """&pendulum e=0.1 w2=0.4 w3=0.8 alpha=0.5 c1=0.01 f0=0.005 p1=0.93 /
&transient initial=0.05 0 0.3 0 -0.2 0 t_end=20 dt=0.25 keep='tail' tail=5 /
&spectrum window='hann' discard=5 /
&event function='phi - 0.1*sin(t)' direction='up' /
""",
    "pendulum_auto": """&pendulum e=0.1 w2=0.4 w3=0.8 c1=0.01 c2=0.01 c3=0.01 m01=0.005 p2=0.4 /
&transient initial=0.05 0 0.3 0 -0.2 0 t_end=20 tolerance=1e-6 keep='last' /
""",
    "pendulum_branch": """&pendulum e=0.1 w2=0.4 w3=0.8 c1=0.05 c2=0.05 c3=0.05 f0=0.01 p1=0.9 /
&branch parameter='p1' from=0.7 to=1.1 harmonics=3 max_points=40 switch=1 /
""",
    "pendulum_backbone": """&pendulum e=0.1 w2=0.4 w3=0.8 /
&backbone mode=1 from=0.01 to=0.1 harmonics=3 max_points=40 /
""",
    "mount_backbone": """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /
&backbone mode=1 from=0.01 to=0.3 harmonics=3 max_points=40 /
""",
    "pendulum_scales": """&pendulum e=0.1 w2=0.4 w3=0.8 c1=0.05 c2=0.05 c3=0.05 f0=0.01 p1=0.9 /
&multiple_scales parameter='p1' from=0.8 to=1.2 count=5 /
""",
    "mount_scales": """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10
  stiffness_phi=2 damping=0.1 0 0 0.1 /
&kernel kind='rzhanitsyn' amplitude=0.048 alpha=0.1 beta=0.05 /
&load amplitude=0.1 /
&multiple_scales parameter='nu' from=1 to=4 count=5 /
""",
    "sweep": """&scene title='a title' /
&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /
&load kind='base' amplitude=0.1 /
&response nu_from=0.5 nu_to=4 nu_count=6 method='linear' coordinates='x' /
&sweep key='mount.mass' min=1 max=2 count=3 /
""",
    "singular_switches": """&structure mass=1 2 stiffness=2 1 damping=0.1 0.1 /
&kernel kind='rabotnov' amplitude=0.5 alpha=0.4 beta=1.5 /
&element on='x1' law='5*max(d - 0.1, 0) + 0.3*d' kernel=1 /
&element on='x2' law='0.2*sign(v)' kernel=0 /
&load on='x1' amplitude=0.8 /
&transient t_end=3 nu=0.9 tolerance=1e-6 times=0 1 3 /
""",
}  # fmt: skip

_GROUP = re.compile(r"&(\w+)\s(.*?)(?<!['\w])/\s*$", re.S | re.M)
_KEY = re.compile(r"(\w+)\s*=\s*((?:'[^']*'|[^=&'])*?)(?=,?\s+\w+\s*=|\s*,?\s*$)", re.S)


@dataclass
class Key:
    """A key with its allowed words; none if it is a number."""

    words: list[str] = field(default_factory=list)
    text: bool = False
    whole: bool = False


@dataclass
class Grammar:
    """Groups with their keys, and initial scenes."""

    groups: dict[str, dict[str, Key]]
    seeds: list[Scene]


def parse(text: str) -> Scene:
    """Parse a scene of these tests: no comments, a slash at the end of each group's last line."""
    plain = re.sub(r"(?m)!(?=[^']*$).*$", "", text)
    groups: Scene = []
    for name, body in _GROUP.findall(plain + "\n"):
        keys = {k.lower(): " ".join(v.split()) for k, v in _KEY.findall(body.strip())}
        groups.append((name.lower(), keys))
    return groups


def text_of(scene: Iterable[tuple[str, dict[str, str]]]) -> str:
    """Return the text of a scene file."""
    return "".join(
        f"&{name}\n" + "".join(f"  {key} = {value}\n" for key, value in keys.items()) + "/\n"
        for name, keys in scene
    )


def learn(driver: Path, cache: Path) -> Grammar:
    """Read the grammar from the driver, once for each build."""
    seeds = [parse(text) for text in SEEDS.values()]
    stamp = f"{driver} {driver.stat().st_mtime_ns} {zlib.crc32(json.dumps(SEEDS).encode())}"
    if cache.exists():
        kept = json.loads(cache.read_text())
        if kept["stamp"] == stamp:
            groups = {
                g: {k: Key(**v) for k, v in keys.items()} for g, keys in kept["groups"].items()
            }
            return Grammar(groups, seeds)
    with tempfile.TemporaryDirectory() as folder:
        groups = _ask(driver, Path(folder), seeds)
    cache.parent.mkdir(parents=True, exist_ok=True)
    kept = {g: {k: vars(v) for k, v in keys.items()} for g, keys in groups.items()}
    cache.write_text(json.dumps({"stamp": stamp, "groups": kept}))
    return Grammar(groups, seeds)


def _ask(driver: Path, folder: Path, seeds: list[Scene]) -> dict[str, dict[str, Key]]:
    def refusal(scene: Scene) -> str:
        (folder / "s.nml").write_text(text_of(scene))
        done = subprocess.run(
            [str(driver), "s.nml", "--plan"], cwd=folder, capture_output=True, text=True, timeout=60
        )
        return done.stderr

    names = re.findall(r"&(\w+)", refusal([("qqqqqq", {})]).partition("one of")[2])
    groups: dict[str, dict[str, Key]] = {name: {} for name in names}
    for scene in seeds:
        for i, (name, keys) in enumerate(scene):
            changed = [*scene[:i], (name, {**keys, "qqqqqqqqqqqqqqqqqqqq": "1"}), *scene[i + 1 :]]
            listed = refusal(changed).partition("must be one of ")[2]
            for key in re.findall(r"\w+", listed):
                if key in groups[name]:
                    continue
                other = [*scene[:i], (name, {**keys, key: "'qqq'"}), *scene[i + 1 :]]
                reported = refusal(other)
                found = groups[name].setdefault(key, Key())
                if "must be one of" in reported and f"{key} =" in reported:
                    found.words = re.findall(r"'(\w+)'", reported.partition("must be one of")[2])
                found.text = bool(found.words) or f"{key} = qqq" not in reported
                found.whole = "integer" in reported
    return groups

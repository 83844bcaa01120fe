"""Variation of every number of every system through every interface; damaged matrix files."""

import io
import random
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from api import ended
from calls import BODY, MOUNT, PENDULUM, STRUCTURE, SYSTEM
from grammar import ROOT, Scene, learn, text_of
from scenes import _NASTY, _USUAL, BUILDS, drive
from scipy.sparse import csc_array, save_npz
from verdicts import Case, run
from worker import Worker

#: Python systems with the arguments of a branch and an ensemble, and names that no message lists
#: because they contain names of coordinates.
_SYSTEMS = (
    (PENDULUM, "harmonics=3, max_points=10", "initial=[0.05, 0, 0.3, 0, -0.2, 0]", ()),
    (SYSTEM, "nu=1.1, load=0.2", "initial=[0.1, 0], load=0.2, nu=1.1",
     ("mass[x,x]", "stiffness[x,x]", "damping[x,x]", "forces[x^3]", "springs[0].forces[x^3]")),
    (MOUNT, "nu=1.1, load=0.2", "initial=[0.1, 0, 0, 0], load=0.2, nu=1.1",
     ("damping[x,x]", "damping[x,phi]")),
    (STRUCTURE, "nu=0.5, load={'x1': 0.01}", "initial=[0.1, 0, 0, 0, 0, 0], load={'x1': 0.1}, nu=1",
     ("elements[0].k3", "elements[0].stiffness", "elements[1].stiffness", "elements[0].limit")),
    (BODY, "nu=20, load=[0, 0, 10, 0, 0, 0]",
     "initial=[0] * 12, load=[0, 0, 10, 0, 0, 0], nu=20",
     ("mounts[foot].stiffness[z]", "mounts[foot].position[x]", "mounts[foot].damping[y]",
      "mounts[foot].stiffness_scale", "mounts[none].stiffness[z]", "center[x]")),
)  # fmt: skip
_NAMED = re.compile(r"'([A-Za-z_][\w.\[\],^*]*)'")
_QUICK = "harmonics=3, max_points=10"


class Varied:
    """The part that varies numbers: in scenes by the driver, in Python, and in sweeps."""

    name = "varied"

    def __init__(self, folder: Path, builds: list[str]) -> None:
        self.folder = folder
        self.builds = [name for name in builds if BUILDS[name][0].exists()]
        self.worker = Worker(folder / "calls")
        self.seeds = learn(BUILDS[self.builds[0]][0], ROOT / "build/fuzz/grammar.json").seeds
        #: Names that can be varied in each initial scene, by its index.
        self._names: dict[int, list[str]] = {}

    def case(self, rng: random.Random, seed: str) -> Case:
        """One interface, one number."""
        ways: tuple[Callable[[random.Random, str], Case], ...] = (
            self._scene, self._swept, self._python,
        )  # fmt: skip
        return rng.choice(ways)(rng, seed)

    def _scene(self, rng: random.Random, seed: str) -> Case:
        places = [i for i, scene in enumerate(self.seeds) if any("vary" in k for _, k in scene)]
        place = rng.choice(places)
        scene = [(name, dict(keys)) for name, keys in self.seeds[place]]
        if place not in self._names:
            self._names[place] = self._asked(scene)
        group = next(keys for _, keys in scene if "vary" in keys)
        names = self._names[place] or ["x"]
        group["vary"] = " ".join(f"'{rng.choice(names)}'" for _ in group["vary"].split())
        for key in ("from", "to"):
            if key in group:
                group[key] = " ".join(_number(rng) for _ in group[key].split())
        if rng.random() < 0.5:
            group.pop("nu", None)
        build = rng.choice(self.builds)
        driver, bounded = BUILDS[build]
        return drive(text_of(scene).encode(), driver, self.folder / "scene", seed, bounded=bounded)

    def _asked(self, scene: Scene) -> list[str]:
        """Names that the driver lists in the message for an unknown name."""
        wrong = [(name, keys | {"vary": "'?'"} if "vary" in keys else keys) for name, keys in scene]
        self.folder.mkdir(parents=True, exist_ok=True)
        (self.folder / "asked.nml").write_text(text_of(wrong))
        command = [str(BUILDS[self.builds[0]][0]), "asked.nml", "--plan"]
        return _NAMED.findall(run(command, self.folder).err)

    def _swept(self, rng: random.Random, seed: str) -> Case:
        """A sweep over any key of a scene."""
        scene = rng.choice(self.seeds)
        place = rng.randrange(len(scene))
        name, keys = scene[place]
        if not keys:
            return self._python(rng, seed)
        key = rng.choice(sorted(keys))
        several = sum(other == name for other, _ in scene) > 1
        which = sum(other == name for other, _ in scene[: place + 1])
        words = keys[key].split()
        path = f"{name}({which}).{key}" if several else f"{name}.{key}"
        path += f"({rng.randint(1, len(words))})" if len(words) > 1 else ""
        values = ", ".join(_number(rng) if rng.random() < 0.9 else repr("x") for _ in range(2))
        values = re.sub(r"\b(nan|inf)\b", r"float('\1')", values.replace("1d0", "1.0"))
        text = f"vv.sweep('a.nml', grid={{{path!r}: [{values}]}}, progress=False, n_threads=1)"
        files = {"a.nml": text_of(scene)}
        answer = self.worker.ask(job="call", text=text, files=files)
        case = ended(self.name, seed, text, answer)
        return Case(
            case.part, seed, case.ending, case.how, {**case.files, "a.nml": files["a.nml"].encode()}
        )

    def _python(self, rng: random.Random, seed: str) -> Case:
        system, branch, start, own = rng.choice(_SYSTEMS)
        names = [*own, *_KNOWN]
        name = rng.choice(names)
        ends = ", ".join(re.sub(r"\b(nan|inf)\b", r"float('\1')", _number(rng)) for _ in range(2))
        ends = ends.replace("1d0", "1.0")
        if rng.random() < 0.5:
            if system == PENDULUM:
                name = name if name.isidentifier() else "p1"
                text = f"vv.trace_response({system}, {name}=({ends}), {branch})"
            else:
                text = (
                    f"vv.trace_response({system}, vary={name!r}, vary_range=({ends}), {branch}, "
                    f"{_QUICK})"
                )
        else:
            text = (
                f"vv.simulate_ensemble({system}, {start}, t_end=2, parameters={{{name!r}: "
                f"[{ends}]}})"
            )
        return ended(self.name, seed, text, self.worker.ask(job="call", text=text))


#: Names of the numbers of all systems.
_KNOWN = (
    "e", "w2", "w3", "alpha", "c1", "c2", "c3", "f0", "m01", "m02", "p1", "p2", "p3", "nu",
    "load_scale", "load_factor", "stiffness_scale", "damping_scale", "forces_scale", "mass_scale",
    "memory_scale", "inertia_scale", "cubic_scale", "mass", "inertia", "offset", "stiffness_x",
    "stiffness_phi", "stiffness", "damping", "k",
)  # fmt: skip


def _number(rng: random.Random) -> str:
    return rng.choice(_NASTY) if rng.random() < 0.4 else rng.choice(_USUAL)


class Matrices:
    """The part that damages matrix files and structure files: their bytes or arrays."""

    name = "matrices"

    def __init__(self, folder: Path) -> None:
        self.worker = Worker(folder)

    def case(self, rng: random.Random, seed: str) -> Case:
        """One file, read into a structure that is then used."""
        draws = np.random.default_rng(rng.getrandbits(32))
        n = rng.randint(1, 8)
        matrix = np.diag(draws.uniform(1, 3, n)) + (draws.random((n, n)) < 0.2) * 0.1
        held = io.BytesIO()
        whole = rng.random() < 0.4
        sparse = csc_array(matrix + matrix.T)
        if whole:
            parts = {"form": np.array("viscovib structure 1"), "loss_factor": np.array(0.1)}
            for name in ("mass", "stiffness"):
                parts |= {f"{name}.{k}": getattr(sparse, k) for k in ("data", "indices", "indptr")}
            names = [f"x{i}" for i in range(n)]
            np.savez(held, **parts, names=np.array(names), units=np.array(["m"] * n))
        else:
            save_npz(held, sparse.asformat(rng.choice(["csc", "csr", "coo", "bsr", "dia"])))
        content = held.getvalue()
        if rng.random() < 0.6:
            with np.load(io.BytesIO(content)) as read:
                arrays = {key: read[key] for key in read.files}
            for _ in range(rng.choice([1, 1, 2])):
                _damage(rng, arrays)
            held = io.BytesIO()
            np.savez(held, **arrays)
            content = held.getvalue()
        else:
            torn = bytearray(content)
            for _ in range(rng.choice([1, 1, 3, 8])):
                torn[rng.randrange(len(torn))] = rng.randrange(256)
            content = bytes(torn[: rng.randrange(len(torn))] if rng.random() < 0.2 else torn)
        files = "'k.npz'" if whole else "'k.npz', 'k.npz'"
        text = f"vv.forced_response(vv.Structure.read({files}), [0.5], load=1.0, method='linear')"
        answer = self.worker.ask(job="call", text=text, files={"k.npz": content.decode("latin-1")})
        case = ended(self.name, seed, text, answer)
        return Case(case.part, seed, case.ending, case.how, {**case.files, "k.npz": content})


def _damage(rng: random.Random, arrays: dict[str, np.ndarray]) -> None:
    """Change an array: an entry, its type, length or dimensions; or omit it."""
    if not arrays:
        return
    key = rng.choice(sorted(arrays))
    array = arrays.pop(key)
    how = rng.randrange(8)
    if how == 0:
        return
    if how < 4 and array.size and array.dtype.kind in "iuf" and array.dtype.itemsize >= 4:
        array = array.copy()
        whole = [2, 7, 99, 10**6, 2**31 - 1]
        whole += [-5, -1, -(2**31)] if array.dtype.kind != "u" else []
        array.reshape(-1)[rng.randrange(array.size)] = rng.choice(
            whole if array.dtype.kind != "f" else [*whole, 1e308, 1e-308, np.nan, np.inf]
        )
    elif how == 4:
        array = array.reshape(-1)[: array.size // 2]
    elif how == 5 and array.dtype.kind in "iuf":
        kinds = ["f8", "c16", "i1", "U3", "u8", "f2", ">i8", ">f8", "?", "S3"]
        with np.errstate(all="ignore"):
            array = array.astype(rng.choice(kinds))
    elif how == 6:
        array = array[np.newaxis]
    elif how == 7:
        words = ["csr", "coo", "bsr", "dia", "lil", 0, 3, -1, 1e9]
        array = np.array(rng.choice(words))
    arrays[key] = array


def parts(folder: Path, builds: list[str]) -> list[Varied | Matrices]:
    """Parts of the fuzzer in this module."""
    return [Varied(folder / "varied", builds), Matrices(folder / "matrices")]

"""Special files: pipes, devices, file names with line breaks; and limited memory or disk space."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
import viscovib as vv
from viscovib.cli.commands import main
from viscovib.common.files import Folder

SCENE = """&mount mass=1 inertia=0.1 offset=0.5 stiffness_x=10 stiffness_phi=2 /
&load amplitude=0.1 /
&response nu=1 2 method='linear' /
"""
READERS = {
    "table": vv.read_dma,
    "kernel": vv.read_kernel,
    "fit": vv.read_fit,
    "scene": vv.Scene.read,
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", ["pipe", "/dev/zero", "/proc/self/status", "."])
def test_only_regular_files_are_read(reader, kind, tmp_path):
    """A pipe would block, a device has no end, files of the system have no size."""
    path = kind
    if kind == "pipe":
        path = tmp_path / "pipe"
        os.mkfifo(path)
    with pytest.raises(vv.FileError, match=r"not a regular file|Is a directory"):
        READERS[reader](path)


@pytest.mark.parametrize("ending", [".mtx", ".npz", ".rb"])
@pytest.mark.parametrize("kind", ["pipe", "/dev/zero", "/proc/self/status"])
def test_only_regular_matrices_are_read(ending, kind, tmp_path):
    """Also for a link to a device with a valid extension."""
    path = tmp_path / f"a{ending}"
    os.mkfifo(path) if kind == "pipe" else path.symlink_to(kind)
    for given in ([path, path], [path]) if ending == ".npz" else ([path, path],):
        with pytest.raises(vv.FileError, match=r"^mass: .*a\.\w+ cannot be read \(not a regular"):
            vv.Structure.read(*given)


@pytest.mark.parametrize("name", ["a.csv", "a.json", "a.nml", "a.mtx", "a.rb", "a.npz"])
def test_files_have_a_largest_size(name, tmp_path):
    """A sparse file takes no disk space, but all of the memory when read."""
    path = tmp_path / name
    path.touch()
    os.truncate(path, 1 << 40)
    readers = {"a.csv": vv.read_dma, "a.json": vv.read_kernel, "a.nml": vv.Scene.read}
    with pytest.raises(vv.FileError, match=r"has more than|not a file of at most"):
        readers.get(name, lambda path: vv.Structure.read(path, path))(path)


def command(*arguments, folder, **given):
    return subprocess.run(
        [sys.executable, "-m", "viscovib", *arguments], cwd=folder, capture_output=True, text=True,
        timeout=60, check=False, **given,
    )  # fmt: skip


def test_names_that_end_lines_are_reported_in_one_line(tmp_path, monkeypatch, capsys):
    (tmp_path / "two\nlines.nml").write_text(SCENE)
    (tmp_path / "blank ").write_text(SCENE)
    monkeypatch.chdir(tmp_path)
    assert main(["run", "two\nlines.nml", "blank ", "no\x1bne.nml", "--out", "o\nut"]) == 3
    out, err = capsys.readouterr()
    assert "o?ut/two?lines_response.csv: " in out
    assert err == "viscovib: no?ne.nml: cannot be read (No such file or directory)\n"
    assert (tmp_path / "o\nut" / "blank _response.csv").exists()
    with pytest.raises(vv.InputError) as raised:
        vv.Scene.read(tmp_path / "two\nlines.nml").override({"a\u2028\x9b": "x" * 9000})
    assert len(str(raised.value).splitlines()) == 1
    assert len(str(raised.value)) < 2000


def test_too_little_room_is_reported(tmp_path):
    """Even if no thread can be started."""
    (tmp_path / "scene.nml").write_text(SCENE)
    done = command("run", "scene.nml", "--max-memory", "0.02", folder=tmp_path)
    assert done.returncode == 1
    assert done.stderr == (
        "viscovib: stopped: more than 0.02 GB of memory are needed (--max-memory)\n"
    )
    assert not list(tmp_path.glob("*.csv"))


def test_a_bound_on_the_size_of_files_is_reported(tmp_path):
    """With one line and without a partial file: the signal of the system is ignored."""
    (tmp_path / "scene.nml").write_text(SCENE.replace("nu=1 2", "nu_from=1 nu_to=2 nu_count=400"))

    def bound():
        resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))

    done = command("run", "scene.nml", folder=tmp_path, preexec_fn=bound)
    assert done.returncode == 3
    assert done.stderr.splitlines()[-1].endswith("cannot be written (File too large)")
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["scene.nml"]


def test_a_full_disk_ends_a_sweep_with_one_line(tmp_path, capsys, monkeypatch):
    """For any file that does not fit; with free space the same command resumes."""
    monkeypatch.chdir(tmp_path)
    grid = "&sweep key='mount.mass', min=1, max=2, count=3 /\n"
    (tmp_path / "scene.nml").write_text(SCENE + grid)
    soft, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    files = set()
    for bound in (100, 1000, 3000, 5000, 8000, 20000):
        out = f"out{bound}"
        resource.setrlimit(resource.RLIMIT_FSIZE, (bound, most))
        try:
            assert main(["sweep", "scene.nml", "--quiet", "--out", out]) == 3
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, most))
        (line,) = capsys.readouterr().err.splitlines()
        assert "(File too large)" in line
        files.add(line.partition(f"{out}/")[2].partition(" (")[0])
        assert not list(Path(out).glob("*.part"))
        assert main(["sweep", "scene.nml", "--quiet", "--out", out]) == 0
    sweep = "scene_sweep.zarr: cannot be"
    assert files >= {f"{sweep} used", f"{sweep} written", "scene_sweep.png: cannot be written"}


def test_a_small_file_takes_little_memory(tmp_path):
    """The memory used depends on the actual size, not on the allowed size."""
    structure = vv.Structure(mass=[1.0], stiffness=[[1.0]])
    structure.write(tmp_path / "a.npz")
    structure.write(tmp_path / "b.mtx")
    folder = Folder(tmp_path)
    soft, most = resource.getrlimit(resource.RLIMIT_AS)
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    bound = pages * resource.getpagesize() + (1 << 28)
    resource.setrlimit(resource.RLIMIT_AS, (bound, most))
    try:
        vv.Structure.read(tmp_path / "a.npz")
        vv.Structure.read(tmp_path / "b_mass.mtx", tmp_path / "b_stiffness.mtx")
        assert len(folder.read("a.npz", 1 << 31)) == (tmp_path / "a.npz").stat().st_size
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, most))
        folder.close()


BODY = vv.Body(
    mass=10, inertia=(0.1, 0.1, 0.1),
    mounts=[vv.MountPoint(name="foot", position=(0, 0, -0.1), stiffness=(1e5, 1e5, 2e5),
                          rotational_stiffness=(1e3, 1e3, 1e3))],
)  # fmt: skip
WRITERS = {
    "a.csv": lambda run, path: run.to_csv(path),
    "a.nc": lambda run, path: run.to_netcdf(path),
    "a.json": lambda _, path: vv.write_kernel(vv.AbelKernel(amplitude=0.1, alpha=0.3), path),
    "a.npz": lambda _, path: vv.Structure(mass=[1.0], stiffness=[[1.0]]).write(path),
    "a.html": lambda _, path: vv.report(BODY, path),
    "a.gif": lambda run, path: vv.animate(run, path, frames=2),
}


@pytest.fixture(scope="module")
def run():
    return vv.simulate(vv.PolynomialSystem(mass=1, stiffness=1), 50, dt=0.1, initial=[1, 0])


@pytest.mark.parametrize("name", WRITERS)
def test_a_pipe_or_a_device_keeps_its_place(name, run, tmp_path):
    """Replacing the device would remove it: /dev/null for all users."""
    os.mkfifo(tmp_path / name)
    with pytest.raises(vv.FileError, match=r"cannot be written \(not a regular file\)"):
        WRITERS[name](run, tmp_path / name)
    assert (tmp_path / name).is_fifo()
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_reported_and_leaves_nothing(name, run, tmp_path):
    _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40, most))
    try:
        with pytest.raises(vv.FileError, match="cannot be written") as raised:
            WRITERS[name](run, tmp_path / name)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
    assert str(raised.value).startswith(str(tmp_path))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("leads", ["precious", "nothing", "itself"])
def test_a_link_is_replaced_and_never_followed(name, leads, run, tmp_path):
    """Neither the link of the file nor that of the temporary file."""
    precious = tmp_path / "precious"
    precious.write_text("precious")
    path = tmp_path / "out" / name
    path.parent.mkdir()
    path.symlink_to(path if leads == "itself" else tmp_path / leads)
    stem, ending = name.split(".")
    for part in (f"{name}.part", f"{stem}.part.{ending}"):
        path.with_name(part).symlink_to(precious)
    WRITERS[name](run, path)
    assert not path.is_symlink()
    assert path.stat().st_size > 0
    assert precious.read_text() == "precious"
    assert not (tmp_path / "nothing").exists()

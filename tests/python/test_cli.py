"""The command line: help, JSON, several scenes per call, completion, progress bars."""

import fcntl
import json
import os
import pty
import struct
import subprocess
import sys
import termios
from pathlib import Path

import pytest
import viscovib as vv
from viscovib.cli.commands import main
from viscovib.common import progress

SCENES = Path(__file__).parents[2] / "data" / "scenes"
PAPER, BRANCH = SCENES / "mount_paper.nml", SCENES / "mount_branch.nml"


def lines(capsys):
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize(
    "command", ["", "run", "plan", "plot", "sweep", "explore", "bench", "completion"]
)
def test_help_has_examples(command, capsys):
    with pytest.raises(SystemExit) as ended:
        main([*command.split(), "--help"])
    assert ended.value.code == 0
    reported = capsys.readouterr().out
    assert f"viscovib {command}".rstrip() in reported[reported.index("examples:") :]


def test_several_scenes_and_the_largest_status(tmp_path, capsys):
    out = ["--out", str(tmp_path), "--json"]
    assert main(["run", str(PAPER), "nope.nml", str(BRANCH), *out]) == 3
    first, none, second = lines(capsys)
    want = vv.run(PAPER).value
    assert first["numbers"]["peak_x"] == {"value": want.peak("x").amplitude, "unit": "m"}
    assert none == {
        "scene": "nope.nml", "status": 3, "error": "nope.nml: cannot be read "
        "(No such file or directory)",
    }  # fmt: skip
    assert second["numbers"]["folds"]["value"] == 2
    for one in (first, second):
        assert one["complete"]
        assert all(Path(path).exists() for path in one["tables"] + one["pictures"])
    assert main(["run", str(PAPER), f"elsewhere/{PAPER.name}", *out]) == 2
    assert "its tables would have the same names as those of" in capsys.readouterr().err


def test_plans_benchmarks_sweeps_and_pictures_as_json(tmp_path, capsys):
    assert main(["plan", str(PAPER), "--json"]) == 0
    (plan,) = lines(capsys)
    assert plan["skips"] == dict(vv.plan(PAPER).skips)
    assert main(["bench", str(PAPER), "--runs", "1", "--json"]) == 0
    (cost,) = lines(capsys)
    assert cost["seconds"]["compute"]["best"] > 0
    out = ["--out", str(tmp_path), "--json"]
    assert main(["sweep", str(PAPER), "--over", "mount.mass=1,2", *out]) == 0
    (sweep,) = lines(capsys)
    assert sweep["sizes"] == {"mount.mass": 2}
    assert all(Path(path).exists() for path in sweep["tables"] + sweep["pictures"])
    assert main(["plot", str(PAPER), *out]) == 0
    assert Path(lines(capsys)[0]["pictures"][0]).exists()


def test_a_shock_spectrum_has_a_picture(tmp_path, capsys):
    scene = str(SCENES / "device_shock.nml")
    assert main(["plot", scene, "--out", str(tmp_path), "--json"]) == 0
    (written,) = lines(capsys)
    names = [Path(path).name for path in written["pictures"]]
    assert names == ["device_shock_transient.png", "device_shock_shock_spectrum.png"]
    assert all((tmp_path / name).stat().st_size > 1e4 for name in names)


def test_what_is_no_number_is_null(tmp_path, capsys):
    # Successive approximations fail at every frequency.
    scene = tmp_path / "fails.nml"
    scene.write_text(
        "&mount mass=1, inertia=0.1, offset=0.5, stiffness_x=10, stiffness_phi=2 /\n"
        "&load amplitude=50 /\n&response nu=1.4 1.5, method='successive' /\n"
    )
    assert main(["run", str(scene), "--out", str(tmp_path), "--json"]) == 1
    (reported,) = lines(capsys)
    assert reported["numbers"]["peak_x"]["value"] is None
    assert not reported["complete"]


def test_bash_completes(tmp_path, capsys):
    (tmp_path / "mount.nml").touch()
    (tmp_path / "mount.csv").touch()
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out

    def completed(*words):
        lines = f"COMP_WORDS=(viscovib {' '.join(words)}); COMP_CWORD={len(words)}; _viscovib"
        said = subprocess.run(
            ["bash", "-c", f'{script}\n{lines}\nprintf "%s\\n" "${{COMPREPLY[@]}}"'],
            capture_output=True, text=True, check=True, cwd=tmp_path,
        )  # fmt: skip
        return said.stdout.split()

    assert completed("pl") == ["plan", "plot"]
    assert completed("run", "mou") == ["mount.nml"]
    assert completed("sweep", "--sch") == ["--scheduler"]
    assert completed("completion", "f") == ["fish"]
    for shell in ("zsh", "fish"):
        assert main(["completion", shell]) == 0
        assert "sweep" in capsys.readouterr().out


def _reported_by_terminal(command, cwd, **environment):
    """Output of a command on a terminal."""
    ours, its = pty.openpty()
    # Lines and columns, without which no bar fits.
    fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 25, 80, 0, 0))
    environment = os.environ | {"CI": ""} | environment
    with subprocess.Popen(command, stdout=its, stderr=its, cwd=cwd, env=environment) as child:
        os.close(its)
        reported = b""
        while True:
            try:
                part = os.read(ours, 4096)
            except OSError:
                break
            if not part:
                break
            reported += part
        assert child.wait() == 0
    os.close(ours)
    return reported.decode()


LONG = """
import multiprocessing, os, sys, threading, viscovib as vv
from viscovib.common import progress
progress.PATIENCE = progress._LOOK = 0.02
duffing = vv.PolynomialSystem(mass=1, stiffness=1, damping=0.1, forces="x^3")
def curve():
    vv.trace_response(duffing, (0.3, 3), load=0.3, max_step=1e-3, max_points=10000)
def motion():
    vv.simulate(duffing, 20000, initial=[0.3, 0], dt=0.05, keep="last")
def in_thread():
    thread = threading.Thread(target=curve)
    thread.start()
    thread.join()
def in_process():
    process = multiprocessing.get_context("fork").Process(target=curve)
    process.start()
    process.join()
def short():
    progress.PATIENCE = 2.0
    curve()
def automatic():
    os.environ["CI"] = "true"
    curve()
    os.environ["CI"] = ""
for work in sys.argv[1:]:
    globals()[work]()
    print("<end>", flush=True)
"""


def test_bars_of_long_work_appear_by_themselves(tmp_path):
    """And not in threads, in other processes, and where the variable CI is set."""
    works = ["curve", "motion", "automatic", "in_thread", "in_process", "short"]
    command = [sys.executable, "-c", LONG, *works]
    reported = _reported_by_terminal(command, tmp_path).split("<end>\r\n")
    assert reported.pop() == ""
    assert len(reported) == len(works)
    assert " points [" in reported[0]
    assert " steps" in reported[1]
    assert reported[2:] == 4 * [""]
    piped = subprocess.run(command[:5], capture_output=True, text=True, check=True)
    assert piped.stdout + piped.stderr == 2 * "<end>\n"


def test_bars_only_on_terminals(tmp_path, monkeypatch, capsys):
    # Without a delay, so that the bar does not depend on the speed of the machine.
    impatient = (
        "import sys; from viscovib.common import progress; progress._PATIENCE = 0.0;"
        "from viscovib.cli.commands import main; sys.exit(main(sys.argv[1:]))"
    )
    scene = tmp_path / "short.nml"
    text = (SCENES / "pendulum_branch.nml").read_text()
    long = "to = 1.2\n  subharmonic = 2, harmonics = 30\n  switch = 1"
    assert long in text
    scene.write_text(text.replace(long, "to = 0.95, harmonics = 6"))
    command = [sys.executable, "-c", impatient, "run", str(scene)]
    assert " points [" in _reported_by_terminal(command, tmp_path)
    monkeypatch.setattr(progress, "_PATIENCE", 0.0)
    monkeypatch.chdir(tmp_path)
    assert main(["run", str(scene)]) == 0
    assert capsys.readouterr().err == ""

"""The referee itself: detection of errors, crashes, and coverage of public names."""

import queue
import threading
import types

import numpy as np
import pytest
import viscovib as vv
from referee import coverage
from referee.balance import growing
from referee.case import Case, Claim
from referee.responses import difference
from referee.session import Verdict, _awaited, _watch
from referee.worker import answer


def test_every_public_name_is_judged_or_has_a_reason():
    assert coverage.complaints() == []


def test_a_new_name_is_missed(monkeypatch):
    monkeypatch.setattr(vv, "__all__", [*vv.__all__, "invented"])
    monkeypatch.setattr(vv, "invented", lambda: None, raising=False)
    assert any(text.startswith("invented: no family") for text in coverage.complaints())


def test_a_new_method_is_missed(monkeypatch):
    monkeypatch.setattr(vv.Mount, "invented", lambda self: None, raising=False)
    assert any(text.startswith("Mount.invented: no family") for text in coverage.complaints())


def test_ratio_is_true_error_over_the_one_admitted():
    claim = Claim("x", np.array([1.0, 2.0]), np.array([1.0, 2.5]), [0.1, 0.25])
    assert claim.ratio() == pytest.approx(2)
    assert Claim("x", 1.0, 1.0, 0.0).ratio() == 0
    assert Claim("x", 1.0, 2.0, 0.0).ratio() == np.inf


@pytest.mark.parametrize(
    "claim",
    [
        Claim("NaN", np.nan, 1.0, 1.0),
        Claim("an estimate of NaN", 1.0, 1.0 + 1e-9, np.nan),
        Claim("a wrong shape", np.ones(2), np.ones(3), 1.0),
        Claim("a wrong verdict", True, False),
        Claim("a wrong word", "completed", "diverged"),
    ],
    ids=lambda claim: claim.what,
)
def test_what_is_wrong_whatever_is_admitted(claim):
    assert claim.ratio() == np.inf


@pytest.mark.parametrize(
    "claim",
    [Claim("x", 2.0, 2.0, 1e-9), Claim("x", True, True), Claim("x", 3, 3), Claim("x", "a", "a")],
)
def test_injected_errors_are_seen(claim):
    assert claim.ratio() == 0
    assert claim.damaged().ratio() > 1


def test_refusals_and_exceptions_are_distinguished():
    refusing = "vv.Mount(mass=-1, inertia=1, offset=0, stiffness_x=1, stiffness_phi=1)"
    assert answer(Case(refusing, lambda *_: [], may_refuse=True))[1] == "refused"
    assert answer(Case(refusing, lambda *_: []))[1] == "raised"
    assert answer(Case("1 / 0", lambda *_: [], may_refuse=True))[1] == "raised"


def test_a_crash_is_a_failure_of_its_case(monkeypatch, tmp_path):
    """A process that dies ends with its current call."""
    program = (
        "import json, os\n"
        "print(json.dumps({'index': 3, 'begin': 'the call'}), flush=True)\n"
        "os.abort()\n"
    )
    path = tmp_path / "dies.py"
    path.write_text(program)
    import subprocess
    import sys

    monkeypatch.setattr(
        "referee.session.subprocess",
        types.SimpleNamespace(
            Popen=lambda _, **options: subprocess.Popen([sys.executable, str(path)], **options),
            PIPE=subprocess.PIPE,
        ),
    )
    index, call, reason = _watch(Verdict("dies"), "dies", 1, 0, 1.0, 0, 9)
    assert (index, call) == (3, "the call")
    assert reason == "the process ended by signal 6"


def test_the_worst_ratio_is_the_one_closest_to_its_limit():
    verdict = Verdict("any")
    claims = [("an estimate", 3.0, 30.0), ("a number", 0.5, 1.0), ("another estimate", 1.5, 10.0)]
    record = {"index": 0, "systems": 1, "ended": "answered"}
    record["claims"] = [[what, ratio, limit, False, True, ""] for what, ratio, limit in claims]
    verdict.take(record, "")
    assert (verdict.worst_claim, verdict.worst, verdict.worst_limit) == ("a number", 0.5, 1.0)


@pytest.mark.parametrize("unit", [1e-3, 0.0254, 1e3])
def test_errors_of_motions_do_not_depend_on_the_unit_of_length(unit):
    """A mount has a displacement and an angle: weighting by masses keeps both comparable."""
    rng = np.random.default_rng(7)
    true = rng.normal(size=(2, 5)) + 1j * rng.normal(size=(2, 5))
    off = true * (1 + [[1e-7], [1e-5]] * rng.normal(size=true.shape))
    one = types.SimpleNamespace(mass=np.diag([1.9, 0.1]))
    other = types.SimpleNamespace(mass=np.diag([1.9, 0.1 / unit**2]))
    scaled = [np.diag([1 / unit, 1]) @ x for x in (off, true)]
    orders = np.arange(5)
    assert difference(other, scaled[0], orders, scaled[1]) == pytest.approx(
        difference(one, off, orders, true), rel=1e-9
    )


@pytest.mark.parametrize(("work", "answers"), [("sum(range(10**8))", False), ("0", True)])
def test_a_case_hangs_by_the_time_of_its_processor(work, answers, monkeypatch):
    """A process that waits for a processor on a busy machine does not count as hanging."""
    import subprocess
    import sys

    monkeypatch.setattr("referee.session.PATIENCE", 0.3)
    monkeypatch.setattr("referee.session.LOOK", 0.1)
    program = f"import time\ntime.sleep(1)\n{work}\nprint('{{}}')\n"
    lines = queue.Queue()
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as process:
        listener = threading.Thread(target=lambda: lines.put(process.stdout.readline()))
        listener.start()
        try:
            if answers:
                assert _awaited(lines, process.pid) == b"{}\n"
            else:
                with pytest.raises(queue.Empty):
                    _awaited(lines, process.pid)
        finally:
            process.kill()
            listener.join()


@pytest.mark.parametrize("family", ["kernels", "linear", "spectra", "tables"])
def test_cases_are_the_same_whenever_they_are_drawn(family):
    import importlib

    from referee.worker import generator

    draw = importlib.import_module(f"referee.{family}").case
    for index in range(8):
        first, again = (draw(generator(5, family, index), index).call for _ in range(2))
        assert first == again


def test_a_large_multiplier_hides_none_near_one():
    """Errors are separate: that of 7e5 does not affect 1.2 and 1.02."""
    sizes = np.array([7e5, 1.2, 1.02, 0.9])
    off = np.array([0.2, 1e-7, 1e-7, 1e-7])
    right = growing(sizes[:3], sizes, off, 1e-5, 3e-9)
    assert right.ratio() < 1 < right.damaged().ratio()
    for wrong in (sizes[:2], sizes[:1], sizes[[0, 1, 2, 2]], np.zeros(0)):
        assert growing(wrong, sizes, off, 1e-5, 3e-9).ratio() == np.inf
    moved = growing(sizes[:3] + [0, 0.01, 0], sizes, off, 1e-5, 3e-9)
    assert moved.ratio() > 1


def test_a_multiplier_too_close_to_one_may_grow_or_not():
    sizes, off = np.array([1.2, 1 + 1e-8, 0.9]), np.array([1e-9, 1e-8, 1e-9])
    for got in (sizes[:1], sizes[:2]):
        assert growing(got, sizes, off, 1e-5, 3e-9).ratio() < 1
    assert growing(sizes[2:], sizes[2:], off[2:], 1e-5, 3e-9) is None

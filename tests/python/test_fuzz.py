"""The fuzzer of the Python interface: earlier findings stay fixed, and it detects faults."""

import inspect
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import viscovib as vv

FUZZ = Path(__file__).parents[1] / "fuzz"
FOUND = sorted((FUZZ / "found").glob("*.call"))
GOOD = ("done", "done with warnings", "refused with a line")


@pytest.fixture(scope="module")
def fuzz():
    """Modules of the fuzzer."""
    sys.path.insert(0, str(FUZZ))
    try:
        import api
        import call_runner
        import calls
        import damage
        import texts

        yield {
            "api": api, "runner": call_runner, "calls": calls, "damage": damage, "texts": texts,
        }  # fmt: skip
    finally:
        sys.path.remove(str(FUZZ))


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    import matplotlib as mpl

    mpl.use("agg")
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("file", FOUND, ids=[file.stem for file in FOUND])
def test_what_was_found_stays_mended(fuzz, file):
    reported = fuzz["runner"].call(file.read_text().strip())
    assert reported["verdict"] in GOOD, reported["detail"]


def test_all_that_is_public_is_called(fuzz):
    api = fuzz["calls"].public()
    named = {callee.text.removeprefix("vv.").partition(".")[0] for callee in api.callees}
    named |= {callee.of for callee in api.callees}
    for name in vv.__all__:
        if name in fuzz["calls"].SERVERS:
            continue
        value = getattr(vv, name)
        if inspect.isclass(value) and issubclass(value, (BaseException, Warning)):
            continue
        fields = getattr(value, "__dataclass_fields__", {})
        assert name in named or fields, name
    # A method needs an object, which a valid call must create.
    made = fuzz["runner"].makers()["makers"]
    missing = {callee.of for callee in api.callees if callee.of} - made.keys() - {""}
    assert not missing, f"SOUND of tests/fuzz/calls.py gives none of {missing}"


@pytest.mark.parametrize(
    ("instead", "verdict"),
    [
        (lambda *a, **k: 1 / 0, "exception"),
        (lambda *a, **k: float("nan"), "not finite"),
        (lambda *a, **k: (_ for _ in ()).throw(vv.InputError("")), "message"),
    ],
)
def test_what_is_wrong_is_found(fuzz, monkeypatch, instead, verdict):
    text = f"this = {fuzz['calls'].KERNEL}\nthis.transform(mu=1)"
    assert fuzz["runner"].call(text)["verdict"] == "done"
    # As if it were code of the package.
    instead.__code__ = instead.__code__.replace(co_filename=vv.__file__)
    monkeypatch.setattr(vv.Kernel, "transform", instead)
    assert fuzz["runner"].call(text)["verdict"] == verdict


def test_a_chunk_that_is_believed_wrongly_is_found(fuzz, monkeypatch):
    """Without checksums swapped chunks would be accepted; the fuzzer detects it."""
    from viscovib.sweeps.seal import Seals

    seeds = [f"{i}" for i in range(40)]
    sound = {fuzz["damage"].checkpoint(seed)["verdict"] for seed in seeds[:6]}
    assert sound <= {"done", "refused with a line"}
    monkeypatch.setattr(Seals, "fits", lambda *_: True)
    # Seed 6 swaps chunks, so it runs first.
    rest = seeds[6:] + seeds[:6]
    assert any(fuzz["damage"].checkpoint(seed)["verdict"] == "not the same" for seed in rest)


#: Each text contains characters that end or begin something in some language.
TEXTS = (
    '\'""" + __import__("os") + """\\ {x} %s `id` $(id)',
    "</pre><script>alert(1)</script><img src=x onerror=alert(1)>' onmouseover='alert(1)",
    '$$\\href{javascript:alert(1)}{x}$$ $\\frac{ a,b"c',
    "$$",
    "x\n&load /\0\ud800\u2028",
)


@pytest.mark.parametrize(
    "place", ["in_python", "in_page", "in_report", "in_notebook", "in_namelist", "in_picture"]
)
def test_texts_of_users_stay_texts(fuzz, place):
    """Code, pages, tables and scenes have the structure of those with a plain word."""
    # Where a figure is drawn for each text, the allowed texts are combined.
    slow = place in ("in_page", "in_report", "in_notebook")
    for text in (" ".join(TEXTS[:4]), *TEXTS[4:]) if slow else TEXTS:
        assert getattr(fuzz["texts"], place)(text) == ""


def test_a_text_that_becomes_code_is_found(fuzz, monkeypatch):
    from viscovib.explorer import page, state

    monkeypatch.setattr(state, "_TYPED", "x'; y = '")
    monkeypatch.setattr(state.State, "python_lines", lambda self: f"x = '{self.now.scene.title}'")
    with pytest.raises(SyntaxError):
        fuzz["texts"].in_python("'")
    assert "other code" in fuzz["texts"].in_python("' + y + '")
    monkeypatch.setattr(page.html, "escape", lambda text: text)
    assert "other tags" in fuzz["texts"].in_page("<b>")


def test_calls_run_in_a_process_with_limits(fuzz, tmp_path):
    part = fuzz["api"].Calls(tmp_path / "api")
    try:
        ask = part.worker.ask
        assert ask(job="call", text="vv.Plan('x')")["verdict"] == "done"
        late = ask(job="call", text="[0 for _ in iter(int, 1)]", patience=0.3)
        assert late["verdict"] == "stopped at a given limit"
        fallen = ask(job="call", text="__import__('os').kill(__import__('os').getpid(), 11)")
        assert fallen["verdict"] == "signal"
        # A new process is started.
        assert ask(job="call", text="vv.Plan('x')")["verdict"] == "done"
    finally:
        part.worker.close()


def test_threads_write_one_file_in_turn(tmp_path):
    """Each call succeeds, and the final file is that of one call."""
    kernel = vv.PronyKernel(weights=[0.1] * 200, rates=[1.0 + i for i in range(200)])
    with ThreadPoolExecutor(8) as pool:
        for done in [pool.submit(vv.write_kernel, kernel, tmp_path / "k.json") for _ in range(200)]:
            done.result()
    found = vv.read_kernel(tmp_path / "k.json")
    assert found.laplace(1.5) == kernel.laplace(1.5)
    assert [path.name for path in tmp_path.iterdir()] == ["k.json"]

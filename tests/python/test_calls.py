"""The interface to the core: tasks with values by name, and objects by handle."""

import pickle
import resource
import threading

import numpy as np
import pytest
import viscovib as vv
from viscovib import _native
from viscovib.analyses.line_fit import LineFit
from viscovib.errors import InputError


@pytest.fixture(name="kernel")
def _kernel():
    rubber = vv.RzhanitsynKernel(amplitude=0.048, alpha=0.1, beta=0.05)
    return _native.Handle("kernel new", kind=rubber._kind, data=rubber._data)


MU = np.array([0.5, 1.0, 2.0])


def test_a_task_finds_the_same_about_an_object_its_copy_and_a_pickled_one(kernel):
    found = _native.run("kernel transform", kernel, mu=MU)["values"]
    again = pickle.loads(pickle.dumps(kernel))
    assert again.number != kernel.number
    assert np.array_equal(_native.run("kernel transform", again, mu=MU)["values"], found)


@pytest.mark.parametrize(
    ("task", "values", "words"),
    [
        ("kernel transfrom", {"mu": MU}, "'kernel transfrom': is not known"),
        ("kernels", {}, "'kernels': is not known"),
        ("kernel transform", {}, "mu: must be given to kernel transform"),
        ("kernel transform", {"mu": 1.0}, "mu: has another type or number of dimensions"),
        ("kernel transform", {"mu": MU * 1j}, "mu: has another type or number of dimensions"),
        ("kernel transform", {"mu": MU[np.newaxis]}, "mu: has another type or number"),
    ],
)
def test_a_task_names_what_is_wrong(kernel, task, values, words):
    with pytest.raises(InputError, match=words):
        _native.run(task, kernel, **values)


def test_a_task_names_the_object_that_it_needs():
    with pytest.raises(InputError, match="kernel transform: needs a kernel"):
        _native.run("kernel transform", mu=MU)


def test_a_handle_that_was_freed_or_never_made_is_an_error(kernel):
    freed = pickle.loads(pickle.dumps(kernel))

    class Foreign:
        number = freed.number

    del freed
    for number in (Foreign.number, 0, -1, 1 << 62, Foreign.number + 1):
        Foreign.number = number
        with pytest.raises(InputError, match="handle: belongs to no object"):
            _native.run("kernel transform", Foreign, mu=MU)


def test_large_results_stay_as_long_as_a_part_of_them_and_no_longer(kernel):
    """They are in the memory of the core, and given arrays are read where they are."""
    given = np.linspace(0.1, 9, 200_000)
    before = given.copy()
    part = _native.run("kernel transform", kernel, mu=given)["values"][7:9]
    assert np.array_equal(given, before)
    fresh = [_native.run("kernel transform", kernel, mu=given + i)["values"] for i in range(4)]
    assert not np.array_equal(fresh[0], fresh[1])
    expected = _native.run("kernel transform", kernel, mu=given[7:9].copy())["values"]
    np.testing.assert_allclose(part, expected, rtol=1e-14)
    del fresh
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(60):  # 190 MB, if each stayed
        _native.run("kernel transform", kernel, mu=given)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak < 20_000


def test_an_object_keeps_a_copy_of_its_values():
    """A later change of the array that it was made from does not change it."""
    samples = np.cos(0.4 * np.arange(20_000.0))
    fit, steady = LineFit(samples, np.array([0.4])), np.zeros(1, dtype=bool)
    _, right = fit.sums(False, steady)
    samples[:] = 0
    assert np.array_equal(fit.sums(False, steady)[1], right)


def test_an_object_that_could_not_be_made_leaves_no_handle():
    with pytest.raises(InputError):
        _native.Handle("kernel new", kind=1, data=np.zeros(0))


def test_threads_make_use_and_free_objects_at_the_same_time(kernel):
    right = _native.run("kernel transform", kernel, mu=MU)["values"]
    wrong = []

    def work():
        for _ in range(300):
            own = pickle.loads(pickle.dumps(kernel))
            for one in (own, kernel):
                if not np.array_equal(_native.run("kernel transform", one, mu=MU)["values"], right):
                    wrong.append(one)

    threads = [threading.Thread(target=work) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_threads_read_scenes_of_different_lengths_at_the_same_time():
    texts = [
        f"&scene title='{'t' * n}' /\n&mount mass={n + 1} inertia=0.1 offset=0.5 stiffness_x=10 "
        "stiffness_phi=2 /\n&modes /\n"
        for n in range(6)
    ]
    right = [_native.run("scene canonical", path="a.nml", text=text)["text"] for text in texts]
    wrong = []

    def work(first):
        for k in range(60):
            i = (first + k) % len(texts)
            found = _native.run("scene canonical", path="a.nml", text=texts[i])["text"]
            if found != right[i]:
                wrong.append(found)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong

"""Messages of the core are complete, each on the thread whose call failed."""

import sys
import threading

import pytest
import viscovib as vv
from viscovib._native import core


def reported(name: str) -> str:
    with pytest.raises(vv.FileError) as refused:
        vv.Scene.read(name)
    return str(refused.value)


def test_long_messages_arrive_whole_on_two_threads_at_once() -> None:
    names = ["/".join([letter * 200] * 8) + f"/{letter}.nml" for letter in "ab"]
    wrong: list[str] = []
    start = threading.Barrier(2)

    def ask(name: str) -> None:
        start.wait()
        for _ in range(200):
            message = reported(name)
            if message != f"{name}: cannot be read (No such file or directory)":
                wrong.append(message)

    # Longer than any fixed text of the core; above 1900 characters the middle is omitted.
    assert all(len(name) > 1600 for name in names)
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        threads = [threading.Thread(target=ask, args=(name,)) for name in names]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(before)
    assert wrong == []


def test_message_is_kept_no_longer_than_until_it_is_reported() -> None:
    reported("nowhere.nml")
    assert core.last_message_length() == 0

"""Work shared among cores."""

import threading

import pytest

from calibrate.inference import parallel


def test_results_come_in_order_and_faults_come_through():
    assert parallel.in_parallel(lambda k: k * k, range(20)) == [k * k for k in range(20)]
    assert parallel.in_parallel(str, []) == []
    with pytest.raises(ZeroDivisionError):
        parallel.in_parallel(lambda k: 1 / k, [1, 0, 2])


def test_fewer_threads_may_be_asked_for(monkeypatch):
    monkeypatch.setattr(parallel, "_most", None)
    assert parallel.threads() >= 1
    parallel.use_threads(1)
    names = set(parallel.in_parallel(lambda _: threading.current_thread().name, range(8)))
    assert parallel.threads() == 1 and len(names) == 1

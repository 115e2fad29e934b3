"""Launches shared by threads: every item once, errors told, memory of a thread its own."""

import gc
import os
import subprocess
import sys
import threading
import weakref
from queue import SimpleQueue

import numpy as np
import pytest
import torch
import warp as wp
from hypothesis import given, settings
from hypothesis import strategies as st

from exmesh_graph.gpu import cores as cores_module
from exmesh_graph.gpu import crew
from exmesh_graph.gpu.cores import available, cores, scratch, share, shared, split, workers
from exmesh_graph.gpu.crew import together
from exmesh_graph.gpu.warp_runtime import launch


@wp.kernel
def count_items(first: int, counts: wp.array(dtype=wp.int32)):
    i = first + wp.tid()
    counts[i] = counts[i] + 1


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 500), st.integers(1, 600), st.integers(0, 5))
def test_every_item_is_done_once(size, grain, count):
    counts = torch.zeros(size + 1, dtype=torch.int32)
    with cores(count):
        split(count_items, size, counts, grain=grain)
    assert counts[:size].tolist() == [1] * size
    assert int(counts[size]) == 0


@given(st.integers(1, 500), st.integers(1, 17), st.integers(1, 60))
def test_runs_are_whole_pieces_and_cover_everything_once(size, count, grain):
    runs = cores_module._runs(size, count, grain)
    assert [first for first, _ in runs] == [sum(n for _, n in runs[:k]) for k in range(len(runs))]
    assert sum(n for _, n in runs) == size
    assert all(first % grain == 0 and n > 0 for first, n in runs)
    assert len(runs) <= 3 * count


def test_a_short_launch_stays_on_its_thread_and_a_long_one_does_not(monkeypatch):
    helped = []
    monkeypatch.setattr(cores_module, "together", lambda work, helpers: (helped.append(helpers), work()))
    counts = torch.zeros(100, dtype=torch.int32)
    with cores(3):
        split(count_items, 100, counts, grain=10)
        monkeypatch.setattr(cores_module, "HANDING", 1e9)
        split(count_items, 100, counts, grain=10)
        split(count_items, 100, counts, grain=10)
        monkeypatch.setattr(cores_module, "HANDING", 1e-12)
        helped.clear()
        split(count_items, 100, counts, grain=10)
    assert helped == [2]
    assert counts.tolist() == [4] * 100


@given(st.floats(0, 0.02))
def test_a_launch_has_as_many_cores_as_end_it_soonest(seconds):
    def ends(count):
        return seconds / count + count * cores_module.HANDING

    assert ends(max(cores_module.paying(seconds), 1)) <= min(map(ends, range(1, 40))) * (1 + 1e-9)
    assert cores_module.paying(float("inf")) > 10**5


def test_whoever_comes_late_does_not_begin(monkeypatch):
    """One thread holds all helpers; the work of another is done without them."""
    released, held, begun = threading.Event(), threading.Semaphore(0), []

    def hold():
        held.release()
        released.wait(20)

    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    monkeypatch.setattr(crew, "_started", [])  # three new threads, and a queue that no other has
    monkeypatch.setattr(crew, "_jobs", SimpleQueue())
    holder = threading.Thread(target=lambda: together(hold, 3))
    holder.start()
    assert all(held.acquire(timeout=20) for _ in range(4))
    together(lambda: begun.append(threading.current_thread()), 2)
    assert begun == [threading.current_thread()]
    released.set()
    holder.join()


def test_what_any_thread_raises_is_raised():
    both = threading.Barrier(2)

    def work():
        both.wait(10)
        if threading.current_thread() is not threading.main_thread():
            raise KeyError("there")

    with pytest.raises(KeyError, match="there"):
        together(work, 1)


def test_cores_are_those_of_the_process_and_end_with_the_block():
    assert available() == len(os.sched_getaffinity(0))
    with cores(0) as count:
        assert count == available()
        with cores(3) as inner:
            assert inner == 3


def test_a_tensor_is_described_by_what_lies_there_now():
    """Memory that is used again, for another shape or type: the launch sees the new tensor."""
    base = torch.zeros(64, dtype=torch.int32)
    for tensor in (base, base[::2], base[16:], base[:3], base[16:]):
        base.zero_()
        launch(count_items, len(tensor), 0, tensor)
        assert tensor.tolist() == [1] * len(tensor)
        assert int(base.sum()) == len(tensor)
    with pytest.raises(RuntimeError):
        launch(count_items, 64, 0, base.view(torch.float32))
    assert int(base.sum()) == 48


def test_several_threads_share_their_launches_at_once():
    results = [torch.zeros(1000, dtype=torch.int32) for _ in range(4)]

    def work(counts):
        with cores(3):
            for _ in range(20):
                split(count_items, 1000, counts, grain=50)

    threads = [threading.Thread(target=work, args=(counts,)) for counts in results]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert all(counts.tolist() == [20] * 1000 for counts in results)


def test_wrong_arguments_are_told_from_every_piece():
    split(count_items, 4, torch.zeros(4, dtype=torch.int32), grain=1)
    with cores(2), pytest.raises((RuntimeError, TypeError)):
        split(count_items, 4, torch.zeros(4, dtype=torch.float32), grain=1)


def test_scratch_is_kept_grows_and_belongs_to_its_thread():
    first = scratch("test", 10)
    assert scratch("test", 5) is first
    assert len(scratch("test", 20)) >= 20
    assert scratch("test", 5, torch.int32).dtype == torch.int32
    mine, others = scratch("test", 5), []
    thread = threading.Thread(target=lambda: others.append(scratch("test", 5)))
    thread.start()
    thread.join()
    assert others[0].data_ptr() != mine.data_ptr()


def test_a_forked_child_has_threads_of_its_own():
    counts = torch.zeros(100, dtype=torch.int32)
    with cores(2):
        split(count_items, 100, counts, grain=10)
        split(count_items, 100, counts, grain=10)
        child = os.fork()
        if child == 0:
            split(count_items, 100, counts, grain=10)
            os._exit(0 if counts.tolist() == [3] * 100 else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


FIRST_LAUNCHES = """
import threading, torch, warp as wp
from exmesh_graph.gpu.warp_runtime import launch

@wp.kernel
def add_one(counts: wp.array(dtype=wp.int32)):
    counts[wp.tid()] = counts[wp.tid()] + 1

together = threading.Barrier(8)
results = [torch.zeros(100000, dtype=torch.int32) for _ in range(8)]

def work(counts):
    together.wait()
    for _ in range(20):
        launch(add_one, 100000, counts)

threads = [threading.Thread(target=work, args=(counts,)) for counts in results]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
assert all(bool((counts == 20).all()) for counts in results)
"""


@pytest.mark.thorough
def test_threads_may_be_the_first_to_launch(tmp_path):
    """Warp initialises itself and loads modules without locks of its own: half of such runs died without ours."""
    script = tmp_path / "first_launches.py"
    script.write_text(FIRST_LAUNCHES)
    run = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr


@wp.kernel
def affine(scale: float, shift: wp.vec3, number: int, values: wp.array(dtype=wp.vec3), out: wp.array(dtype=float)):
    i = wp.tid()
    out[i] = scale * values[i][number] + shift[number]


def test_a_launch_takes_its_own_arguments_and_none_of_the_last():
    for size, scale, number in ((5, 2.0, 0), (9, np.float32(0.5), np.int64(2)), (1, 3, True), (5, -1.0, 1)):
        values, out = torch.rand(size, 3), torch.zeros(size)
        launch(affine, size, scale, wp.vec3(1.0, 2.0, float(scale)), number, values, out)
        shift = [1.0, 2.0, float(scale)][int(number)]
        assert torch.allclose(out, float(scale) * values[:, int(number)] + shift)


@pytest.mark.thorough
def test_a_launch_keeps_no_memory_of_its_tensors():
    counts = torch.zeros(67, dtype=torch.int32)  # of a layout that no other test has
    memory = weakref.ref(counts.untyped_storage())
    launch(count_items, 67, 0, counts)
    assert int(counts.sum()) == 67
    del counts
    gc.collect()
    assert memory() is None


def test_descriptors_of_tensors_reach_kernels_of_every_shape():
    counts = torch.zeros(0, dtype=torch.int32)
    launch(count_items, 0, 0, counts)


@pytest.mark.parametrize("count", [1, 3])
def test_results_are_made_a_few_before_they_are_asked_for(count):
    made = []

    def square(a):
        made.append(a)
        return a * a

    with cores(count):
        results = shared(square, range(100))
        assert [next(results) for _ in range(5)] == [0, 1, 4, 9, 16]
        assert len(made) <= 5 + count + 1
        assert list(results) == [a * a for a in range(5, 100)]


@pytest.mark.parametrize("count", [1, 3])
def test_calls_are_shared_in_order_and_their_errors_told(count):
    with cores(count):
        assert share(lambda a, b: a - b, range(20), range(20, 40)) == [-20] * 20
        assert share(str, range(5)) == ["0", "1", "2", "3", "4"]
        assert share(lambda _: workers(), range(4)) == [1] * 4
        with pytest.raises(ZeroDivisionError):
            share(lambda a: 1 / a, [2, 1, 0, 3])

"""What a node gives back: once it is up, and of the messages it sent and got."""

import os
import subprocess
import sys
from pathlib import Path

from own_process import printed_by

from ladar_volume.process.memory import FROM_PROFILES, PROFILES, free_buffers, unchanged_pages

ROOT = Path(__file__).parents[2]

SMAPS = """\
7f0000000000-7f0000004000 r-xp 00000000 08:01 42 /opt/some where/libllvmlite.so
Rss:                  16 kB
Anonymous:             0 kB
7f0000004000-7f0000006000 r--p 00004000 08:01 42 /opt/libllvmlite.so
Anonymous:             8 kB
7f0000006000-7f0000007000 rw-p 00006000 08:01 42 /opt/libllvmlite.so
Anonymous:             0 kB
7f0000007000-7f0000009000 r--p 00000000 08:01 43 /opt/wheels.soft/table.bin
Anonymous:             0 kB
7f0000009000-7f000000a000 r--p 00006000 08:01 42 /opt/libm.so.6
Anonymous:             0 kB
7f000000a000-7f000000b000 r-xp 00000000 00:00 0
Anonymous:             0 kB
VmFlags: rd ex mr mw me
"""


def test_only_what_is_as_in_the_file_is_given_back():
    # not what was relocated, not what may be written, not what is no library, not what has no file
    wanted = [(0x7F0000009000, 0x1000)]
    assert unchanged_pages(SMAPS) == [(0x7F0000000000, 0x4000), *wanted]
    assert unchanged_pages("") == []


def test_kernels_run_and_compile_after_the_libraries_were_given_back():
    code = """if True:
    import numba, numpy as np
    from ladar_volume.process import memory
    from ladar_volume.uncertainty.navigation_sum import markov_sum

    memory.few_arenas()
    t, y = np.arange(3.0), np.ones((3, 2))
    first = markov_sum(t, y, 1.0)
    size = lambda: next(
        int(l.split()[1]) for l in open("/proc/self/status") if l.startswith("RssFile")
    )
    before = size()
    memory.tidy()
    assert size() < before - 20_000, (before, size())
    assert markov_sum(t, y, 1.0) == first
    assert numba.njit(lambda x: x + 1)(1) == 2
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_kernels_compile_for_good_after_the_modules_of_those_they_call_were_packed(tmp_path):
    (tmp_path / "caller.py").write_text(
        "import numba\nfrom ladar_volume.uncertainty.navigation_sum import markov_sum\n"
        "@numba.njit(cache=True)\ndef twice(t, y):\n    return 2.0 * markov_sum(t, y, 1.0)\n"
    )
    code = """if True:
    import gc, sys
    import numpy as np
    from numba.core.codegen import CPUCodeLibrary
    from ladar_volume.process import memory
    from ladar_volume.uncertainty.navigation_sum import markov_sum

    t, y = np.arange(3.0), np.ones((3, 2))
    held = lambda: sum(
        getattr(x, "_shared_module", None) is not None
        for x in gc.get_objects()
        if isinstance(x, CPUCodeLibrary)
    )
    if sys.argv[1] == "packed":
        once = markov_sum(t, y, 1.0)
        before = held()
        memory.pack_modules()
        assert before > 0 and held() == 0, before
    from caller import twice

    value = twice(t, y)
    assert value == 2.0 * markov_sum(t, y, 1.0)
    assert sum(twice.stats.cache_hits.values()) == (sys.argv[1] == "alone")
"""
    env = os.environ | {"PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}
    warm = (
        "from ladar_volume.uncertainty.navigation_sum import markov_sum; import numpy as np; "
        "markov_sum(np.arange(3.0), np.ones((3, 2)), 1.0)"
    )
    for arguments in (["-c", warm], ["-c", code, "packed"], ["-c", code, "alone"]):
        done = subprocess.run(
            [sys.executable, *arguments], cwd=ROOT, env=env, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr


def test_kernels_of_a_node_need_no_linear_algebra_of_scipy():
    code = """if True:
        import sys
        from ladar_volume.process import memory
        from ladar_volume.compile_kernels import warm_up
        memory.without_blas()
        warm_up("georeference")
        warm_up("filter")
        assert "scipy.linalg" not in sys.modules and memory.BLAS not in sys.modules
        warm_up("volume")
        from scipy.linalg import cython_blas
    """
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_what_a_large_process_frees_goes_back_at_once():
    # blocks of 320 kB, each held in its place by one that stays
    code = """if True:
        import sys
        import numpy as np
        from ladar_volume.process import memory
        memory.few_arenas()
        memory.LARGE_BYTES = 0 if sys.argv[1] == "large" else 1 << 60
        memory.release_memory()
        blocks, stay = [], []
        for _ in range(300):
            blocks.append(np.ones(40_000))
            stay.append(np.ones(500))
        before = memory.resident_bytes()
        del blocks
        print(before - memory.resident_bytes())
    """
    freed = {}
    for size in ("small", "large"):
        done = subprocess.run(
            [sys.executable, "-c", code, size], cwd=ROOT, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        freed[size] = int(done.stdout)
    assert freed["large"] > 90_000_000 > 45_000_000 > freed["small"], freed


SENT = """if True:
    import array, sys, time
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from sensor_msgs.msg import PointCloud2
    from ladar_volume.process import memory
    from ladar_volume.nodes.qos import STREAM

    memory.few_arenas()
    if sys.argv[1] == "free":
        memory.free_buffers()
    size = lambda: (
        next(int(l.split()[1]) for l in open("/proc/self/status") if l.startswith("VmRSS")) / 1024
    )
    rclpy.init(args=[])
    node, executor, got = rclpy.create_node("both"), SingleThreadedExecutor(), []
    executor.add_node(node)
    publisher = node.create_publisher(PointCloud2, "table", STREAM)
    node.create_subscription(PointCloud2, "table", lambda m: got.append(len(m.data)), STREAM)
    while not publisher.get_subscription_count():
        time.sleep(0.05)
    message, before = PointCloud2(data=array.array("B", bytes(2_000_000))), size()
    for _ in range(30):
        publisher.publish(message)
    waiting, deadline = size(), time.monotonic() + 60.0
    while len(got) < 30 and time.monotonic() < deadline:
        executor.spin_once(timeout_sec=0.1)
    assert got == [2_000_000] * 30
    memory.release_memory()
    print(waiting - before, size() - before)
    node.destroy_node()
    rclpy.shutdown()
"""


def sent(how):
    """What messages of 60 MB take while they wait, and once they are taken (MB)."""
    return [float(word) for word in printed_by("-c", SENT, how).split()]


def test_buffers_of_messages_that_were_taken_are_free(monkeypatch):
    for name in (PROFILES, FROM_PROFILES):
        monkeypatch.delenv(name, raising=False)
    waiting, taken = sent("free")
    assert waiting > 50.0 and taken < 10.0
    assert sent("keep")[1] > 50.0  # what Fast DDS does by itself


def test_profiles_of_ones_own_stay(monkeypatch):
    monkeypatch.setenv(PROFILES, "mine.xml")
    monkeypatch.delenv(FROM_PROFILES, raising=False)
    free_buffers()
    assert os.environ[PROFILES] == "mine.xml" and FROM_PROFILES not in os.environ

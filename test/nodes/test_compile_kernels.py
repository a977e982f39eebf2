"""What a node compiles before data comes is all that data then needs."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path

from own_process import python_path

ROOT = Path(__file__).parents[2]


def test_a_survey_needs_no_kernel_that_was_not_ready():
    code = """if True:
    import sys
    from pathlib import Path
    from numba.core.caching import Cache
    from ladar_volume import compile_kernels
    from ladar_volume.replay import Replay
    from ladar_volume.io.bags import BagReader
    from ladar_volume.io.config import read_config
    from ladar_volume.change.epoch_change import epoch_difference

    for stage in compile_kernels.STAGES:
        compile_kernels.warm_up(stage)
    late, load = [], Cache.load_overload
    Cache.load_overload = lambda self, sig, context: (
        late.append((self._py_func.__qualname__, sig)),
        load(self, sig, context),
    )[1]
    for seconds in (8.0, 12.0):  # with places that were not seen, and without
        with BagReader(Path("bags/stockpile")) as bag:
            replay = Replay(
                bag,
                read_config(Path("bags/stockpile/config.yaml"), ["filter.trials=5"]),
                bag.roles(),
                0.0,
                seconds,
            )
            replay.run()
    replay.engine.estimator.more_data()
    now = replay.engine.estimator.epoch()
    epoch_difference(now, now)
    print(late)
    sys.exit(bool(late))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-500:] + done.stderr


def test_a_cloud_in_no_order_needs_no_kernel_that_was_not_ready():
    code = """if True:
    import sys
    import numpy as np
    from numba.core.caching import Cache
    from ladar_volume import compile_kernels
    from ladar_volume.clouds.filter_cloud import filter_cloud
    from ladar_volume.model.cloud_filter_parameters import FilterParameters

    compile_kernels.warm_up(compile_kernels.CLOUDS)
    late, load = [], Cache.load_overload
    Cache.load_overload = lambda self, sig, context: (
        late.append((self._py_func.__qualname__, sig)),
        load(self, sig, context),
    )[1]
    rng = np.random.default_rng(4)
    xy = rng.uniform(-3.0, 3.0, (3000, 2))
    z = np.maximum(0.0, 1.2 - np.hypot(*xy.T)) + rng.normal(0.0, 0.01, len(xy))
    filter_cloud(np.c_[xy, z], FilterParameters(), auto=True)
    print(late)
    sys.exit(bool(late))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-500:] + done.stderr


def test_a_first_start_tells_how_far_the_compiler_is(tmp_path):
    code = """if True:
    import numba, sys, time
    from ladar_volume.nodes.watch.first_start import compilation_reports
    from ladar_volume.process.kernel_cache import keep

    def of(n):
        kernel = numba.njit(lambda x: x + n)
        keep(kernel)
        return kernel

    said = []
    with compilation_reports(said.append, 0.01):
        print(of(1)(2))
        while not said:
            time.sleep(0.01)
    print(said[-1])
    said.clear()
    with compilation_reports(said.append, 0.01):  # nothing is compiled: nothing is told
        time.sleep(0.05)
    print(said)
    """
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": python_path(ROOT)}
    script = tmp_path / "script.py"
    script.write_text(textwrap.dedent(code.removeprefix("if True:\n")))
    done = subprocess.run(
        [sys.executable, script], cwd=ROOT, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    answer, told, after = done.stdout.splitlines()
    assert answer == "3" and told.startswith("compiling kernels, 1 so far in") and after == "[]"
    assert done.stderr.count("compiling kernels") == 1 and "they are kept" in done.stderr

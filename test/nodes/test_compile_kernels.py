"""What a node compiles before data comes is all that data then needs."""

import subprocess
import sys
from pathlib import Path

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
    with BagReader(Path("bags/stockpile")) as bag:
        replay = Replay(
            bag,
            read_config(Path("bags/stockpile/config.yaml"), ["filter.trials=5"]),
            bag.roles(),
            0.0,
            12.0,
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

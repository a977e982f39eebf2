"""One-line bugs in georeference, rmls, volume, change, clouds, io and nodes, and the test files
that see each: signs, units, steps by one, forgotten parameters, fsyncs, covariances exchanged.

``python -m benchmarks.planted_rooms [--half 0|1] [--skip N] [WORD ...]``: all of them, every
second one (to share them between two cores), those after the first N, or those whose file or name
holds a word; exit code 1 where one is not seen, or the tests do not end in time.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from benchmarks.planted import ROOT, SECONDS, passes_all, planted_in


@dataclass(frozen=True)
class Line:
    """name · file, below ladar_volume · good, bad : what is replaced by what, once · tests : files
    or folders below test
    """

    name: str
    file: str
    good: str
    bad: str
    tests: tuple[str, ...]


HERE = "test_room_formulas.py"
GEO = ("georeference", HERE)
RMLS = (
    *("rmls/test_filter_twins.py", "rmls/test_filter_variance.py", "rmls/test_filter_admission.py"),
    "rmls/test_filter_surfaces.py",
    HERE,
)
PRISMOIDS = ("volume/test_prismoids.py", "volume/test_cutfill.py", "volume/test_oracle.py", HERE)
FLOORS = ("volume/test_floors.py", HERE)
ESTIMATOR = (
    *("volume/test_estimator.py", "volume/test_estimator_near_base.py"),
    *(
        "volume/test_estimator_ratio.py",
        "volume/test_more_data.py",
        "volume/test_chords_of_a_fill.py",
    ),
    "clouds/test_bodies.py",
    HERE,
)
NEAR = ("volume/test_near_base.py", "volume/test_remaining_fold.py", HERE)
DENSITY = ("change/test_density.py", HERE)
RING = ("change/test_ring_fit.py", "change/test_excavation.py", "change/test_two_surfaces.py", HERE)
EPOCHS = ("change/test_epochs.py", "change/test_detection.py", HERE)
CLOUD_VOLUME = (
    *("clouds/test_volume_meaning.py", "clouds/test_cloud_volume.py", "cli/test_volume_verb.py"),
    HERE,
)
NOISE = ("clouds/test_cloud.py", "clouds/test_scan_lines.py", HERE)
PAIR = ("clouds/test_volume_meaning.py", HERE)
METRES = (
    "io/test_metres.py",
    "cli/test_file_units.py",
    "io/test_pointfiles.py",
    "io/test_las_attributes.py",
    HERE,
)
TIMES = ("io/test_point_layouts.py", "io/test_messages_bags.py", "io/test_bad_clouds.py", HERE)
LOG = ("io/test_recorder.py", "test_planted_bugs.py", HERE)
SETS = ("io/test_output_set.py", HERE)
LOGGER = (
    "nodes/test_logger_node.py",
    "nodes/test_publisher_numbers.py",
    "test_planted_bugs.py",
    HERE,
)
FLOW = ("nodes/test_flow_control.py", "nodes/test_passes_health.py", "nodes/test_flush.py", HERE)
CDR = ("io/test_cdr.py", "nodes/test_epoch_node.py", HERE)
CONVERT = ("nodes/test_pose_messages.py", "nodes/test_epoch_node.py", "nodes/test_flush.py", HERE)

LINES = (
    # georeference
    Line(
        "lever arms added",
        "georeference/mapping.py",
        "arm = mount.lever_laser - mount.lever_antenna",
        "arm = mount.lever_laser + mount.lever_antenna",
        GEO,
    ),
    Line(
        "azimuth and vertical noise exchanged",
        "georeference/mapping.py",
        "sigmas[0] / rho, sigmas[1], sigmas[2]",
        "sigmas[0] / rho, sigmas[2], sigmas[1]",
        GEO,
    ),
    Line(
        "poses past by one time only",
        "georeference/georeferencer.py",
        "> POSES_PAST * pending_ns",
        "> pending_ns",
        GEO,
    ),
    Line(
        "clock offset taken away",
        "georeference/georeferencer.py",
        "Returns(kept.t_ns + self.mount.clock_ns,",
        "Returns(kept.t_ns - self.mount.clock_ns,",
        GEO,
    ),
    Line(
        "a corrupt stamp expires what waits",
        "georeference/georeferencer.py",
        "min(max(now_ns - before_ns, 0), _LARGEST_STEP_NS)",
        "max(now_ns - before_ns, 0)",
        GEO,
    ),
    Line(
        "tangents weighted the wrong way round",
        "georeference/trajectory.py",
        "(chord[:-1] * h[1:] + chord[1:] * h[:-1])",
        "(chord[:-1] * h[:-1] + chord[1:] * h[1:])",
        GEO,
    ),
    Line(
        "a rate the sum of both turns",
        "georeference/trajectory.py",
        "0.5 * (before + after)",
        "(before + after)",
        GEO,
    ),
    Line(
        "pose covariance turned by the transpose",
        "georeference/error_budget.py",
        "np.eye(3), matrix_from_quaternion(q_map_body).T",
        "np.eye(3), matrix_from_quaternion(q_map_body)",
        GEO,
    ),
    Line(
        "half the divergence as noise",
        "georeference/error_budget.py",
        "budget.beam_divergence_rad / 4.0",
        "budget.beam_divergence_rad / 2.0",
        GEO,
    ),
    Line(
        "attitude covariance turned by the transpose",
        "georeference/error_budget.py",
        "R.T @ C_axes @ R",
        "R @ C_axes @ R.T",
        GEO,
    ),
    Line(
        "navigation covariance of the other neighbour",
        "georeference/point_jacobian.py",
        "states.C_nav[geometry.state] * (1.0 - f) + states.C_nav[nxt] * f",
        "states.C_nav[geometry.state] * f + states.C_nav[nxt] * (1.0 - f)",
        GEO,
    ),
    Line(
        "a whole period of attitudes",
        "georeference/clock_check.py",
        "median(self._steps) // 2",
        "median(self._steps)",
        GEO,
    ),
    Line(
        "a clock set back believed after a quarter",
        "georeference/sample_admission.py",
        "elif 2 * (t_ns - back.newest_ns) >= back.step_ns",
        "elif 4 * (t_ns - back.newest_ns) >= back.step_ns",
        GEO,
    ),
    # rmls
    Line(
        "variance across the slope once",
        "rmls/projection.py",
        "variance / (slope * slope)",
        "variance / slope",
        RMLS,
    ),
    Line(
        "noise of a mean as of its sum",
        "rmls/projection.py",
        "D[i, 2] * P[2, j]) / (size * size)",
        "D[i, 2] * P[2, j]) / size",
        RMLS,
    ),
    Line(
        "normals away from the beam", "rmls/refit_kernels.py", "facing > 0.0", "facing < 0.0", RMLS
    ),
    Line(
        "motion by the rate reversed",
        "rmls/point_admission.py",
        "m[0] += w[1] * s[2] - w[2] * s[1]",
        "m[0] -= w[1] * s[2] - w[2] * s[1]",
        RMLS,
    ),
    # volume
    Line(
        "a sloped base moves the edge the other way",
        "volume/prismoids.py",
        "gradient[:, :2] -= gradient[:, 2:] * slope_base",
        "gradient[:, :2] += gradient[:, 2:] * slope_base",
        PRISMOIDS,
    ),
    Line(
        "a hat half as wide",
        "volume/floors.py",
        "step * step / 6.0",
        "step * step / 12.0",
        FLOORS,
    ),
    Line(
        "gradient of a floor without its step",
        "volume/floors.py",
        "pull = (z - event.level_m) / event.area_m2 / step",
        "pull = (z - event.level_m) / event.area_m2",
        FLOORS,
    ),
    Line(
        "sigma of an offset as of a mean square",
        "volume/floors.py",
        "d, float(np.sqrt(r @ r / (len(z) - 1) / information)), float(r @ r), len(z)",
        "d, float(np.sqrt(r @ r / information)), float(r @ r), len(z)",
        FLOORS,
    ),
    Line(
        "parabola on the other side",
        "volume/floors.py",
        "(left - right) / bend",
        "(right - left) / bend",
        FLOORS,
    ),
    Line(
        "chords of the fill on the wrong side",
        "volume/measured_body.py",
        "solid.fill_m3 - folded + below",
        "solid.fill_m3 - folded - below",
        ESTIMATOR,
    ),
    Line(
        "confidence of one side",
        "volume/measured_body.py",
        "inv_cdf(0.5 + v.confidence / 2)",
        "inv_cdf(v.confidence)",
        ESTIMATOR,
    ),
    Line(
        "joint covariance not scaled",
        "volume/estimator.py",
        "joint *= larger[:, None] * larger",
        "joint *= 1.0",
        ESTIMATOR,
    ),
    Line(
        "joint covariance twice",
        "volume/estimator.py",
        "0.5 * (pair_variance(a, b)",
        "1.0 * (pair_variance(a, b)",
        ESTIMATOR,
    ),
    Line(
        "time of the last message, not the newest",
        "volume/estimator.py",
        "self._t_ns = max(self._t_ns, t_ns)",
        "self._t_ns = t_ns",
        ESTIMATOR,
    ),
    Line(
        "platform states after the surface forgotten",
        "volume/estimator.py",
        "        self._navigation.add(states)\n        self._sources_now = None",
        "        self._navigation.add(states)",
        ESTIMATOR,
    ),
    Line(
        "second order twice",
        "volume/near_base.py",
        "return 0.5 * float(trace_kernel",
        "return 1.0 * float(trace_kernel",
        NEAR,
    ),
    # change
    Line(
        "fourth order of the density",
        "change/density.py",
        "8.0 * uv**4",
        "3.0 * uv**4",
        DENSITY,
    ),
    Line(
        "loads that err alike",
        "change/density.py",
        "np.hypot(one * np.sqrt(len(loads)), shared * total)",
        "np.hypot(one * len(loads), shared * total)",
        DENSITY,
    ),
    Line(
        "correlated share without its two",
        "change/density.py",
        "2.0 * np.pi * L**2 / S",
        "np.pi * L**2 / S",
        DENSITY,
    ),
    Line(
        "known registration forgotten",
        "change/ring_budget.py",
        "np.sqrt(fit.effect_sigma_m3**2 + known)",
        "np.sqrt(fit.effect_sigma_m3**2)",
        RING,
    ),
    Line(
        "noise of a moved scan turned back",
        "change/ring_budget.py",
        "T.R @ np.asarray(b.noise) @ T.R.T",
        "T.R.T @ np.asarray(b.noise) @ T.R",
        RING,
    ),
    Line(
        "three parameters take no freedom",
        "change/ring_fit.py",
        "count / max(count - ALONG, 1.0)",
        "1.0",
        RING,
    ),
    Line(
        "a motion taken out twice",
        "change/ring_fit.py",
        "Transform(R.T, model.pivot - R.T @ by_map[3:]",
        "Transform(R.T, model.pivot + R.T @ by_map[3:]",
        RING,
    ),
    Line(
        "gap of the ring from B to A",
        "change/two_surfaces.py",
        "hits[1].distance - hits[0].distance",
        "hits[0].distance - hits[1].distance",
        RING,
    ),
    Line(
        "a triangle in the outline by its corner",
        "change/epoch_change.py",
        ">= 0.5 * footprint_areas",
        "> 0.0 * footprint_areas",
        EPOCHS,
    ),
    Line(
        "one-sided probability",
        "change/epoch_change.py",
        "math.erfc(abs(z) / math.sqrt(2.0))",
        "0.5 * math.erfc(abs(z) / math.sqrt(2.0))",
        EPOCHS,
    ),
    Line(
        "height noise by the slope once",
        "change/cut_and_fill.py",
        "np.maximum(np.abs(points.normal[:, 2]), LEAST_UPWARD) ** 2",
        "np.maximum(np.abs(points.normal[:, 2]), LEAST_UPWARD)",
        EPOCHS,
    ),
    Line(
        "the rest of a lift by its share",
        "change/cut_and_fill.py",
        "math.sqrt(1.0 - alike**2)",
        "(1.0 - alike)",
        EPOCHS,
    ),
    Line(
        "registration of scan A forgotten",
        "change/two_surfaces.py",
        '("registration_a", result.gradient_a, transform_a, source_a),',
        '("registration_a", result.gradient_b, transform_b, source_b),',
        RING,
    ),
    # clouds
    Line(
        "fill over gaps added to the cut's side",
        "volume/cutfill.py",
        "return cut_m3, fill_m3 - more_m3",
        "return cut_m3, fill_m3 + more_m3",
        CLOUD_VOLUME,
    ),
    Line(
        "unseen volume as its own variance",
        "clouds/volume_verdict.py",
        "+ between.unseen_m3**2",
        "+ between.unseen_m3",
        CLOUD_VOLUME,
    ),
    Line(
        "rounding with a twelfth",
        "clouds/cloud_noise.py",
        "floor = step / math.sqrt(12.0)",
        "floor = step / 12.0",
        NOISE,
    ),
    Line(
        "residuals not scaled by their fit",
        "clouds/cloud_noise.py",
        "return level / np.sqrt(1.0 + np.maximum(first[:, 0], 0.0)), narrow",
        "return level, narrow",
        NOISE,
    ),
    Line(
        "fill of the second surface certain",
        "clouds/cloud_volume.py",
        "math.hypot(a.sigma_fill_m3, b.sigma_fill_m3)",
        "a.sigma_fill_m3",
        CLOUD_VOLUME,
    ),
    Line(
        "plane raised by the offset",
        "clouds/cloud_volume.py",
        "plane = (v.plane[0] - lower_m, *v.plane[1:])",
        "plane = (v.plane[0] + lower_m, *v.plane[1:])",
        CLOUD_VOLUME,
    ),
    Line(
        "the base moves against its points",
        "clouds/cloud_volume.py",
        "gradient[base.support, k] += ground_residuals",
        "gradient[base.support, k] -= ground_residuals",
        CLOUD_VOLUME,
    ),
    Line(
        "noise between points by the square",
        "clouds/between_points.py",
        "/ (ratio**3 - 1.0)",
        "/ (ratio**2 - 1.0)",
        CLOUD_VOLUME,
    ),
    Line(
        "unseen steps by a half",
        "clouds/between_points.py",
        "np.ptp(corner, axis=1)).sum()) / 3.0",
        "np.ptp(corner, axis=1)).sum()) / 2.0",
        CLOUD_VOLUME,
    ),
    Line(
        "registration known for certain",
        "clouds/sampling/pair_registration.py",
        "effect**2 + (found.sigma_m * volume.area_m2) ** 2",
        "effect**2",
        PAIR,
    ),
    Line(
        "gaps of a fill on the wrong side",
        "clouds/pair_verdict.py",
        "sign * found.more_m3",
        "found.more_m3",
        PAIR,
    ),
    # io
    Line(
        "ground factor upside down",
        "io/pointfiles/metres.py",
        "float((1.0 + z / EARTH_M) ** 2 / areal)",
        "float((1.0 + z / EARTH_M) ** 2 * areal)",
        METRES,
    ),
    Line(
        "degrees of longitude as long as of latitude",
        "io/pointfiles/metres.py",
        "[step[0] * degree * np.cos(np.radians(latitude)), step[1]",
        "[step[0] * degree, step[1]",
        METRES,
    ),
    Line(
        "the stamp as that of the first return",
        "io/drivers/return_times.py",
        "offset = offset - offset.max()",
        "offset = offset - offset.min()",
        TIMES,
    ),
    Line(
        "times cut to whole nanoseconds",
        "io/drivers/return_times.py",
        "rest = np.rint((clean - whole) * scale)",
        "rest = np.floor((clean - whole) * scale)",
        TIMES,
    ),
    Line(
        "room for one reserve after the disk was full",
        "io/recorder.py",
        "self.has_room(2 if self.problem else 1)",
        "self.has_room(1)",
        LOG,
    ),
    Line(
        "repeated messages in the account",
        "io/recorder.py",
        "self._settled = dict(log.accepted)",
        "self._settled = {}",
        LOG,
    ),
    Line(
        "a chunk lost and not counted",
        "io/recorder.py",
        "self.account(topic).disk += accepted - self._settled.get(topic, 0)",
        "self.account(topic).disk += 0",
        LOG,
    ),
    Line(
        "time of sending forgotten",
        "io/mcap_log.py",
        "published = t_ns if published_ns is None else published_ns",
        "published = t_ns",
        LOG,
    ),
    Line(
        "sequence numbers of 16 bits",
        "io/mcap_log.py",
        "sequence & 0xFFFFFFFF",
        "sequence & 0xFFFF",
        LOG,
    ),
    Line(
        "a file in place before it is on the disk",
        "io/atomic_write.py",
        "sync(part / path.name)",
        "(part / path.name)",
        SETS,
    ),
    Line(
        "the name of a file not on the disk",
        "io/atomic_write.py",
        "(part / path.name).replace(path)\n            sync(path.parent)",
        "(part / path.name).replace(path)",
        SETS,
    ),
    Line(
        "a folder of results in place before it is on the disk",
        "io/output_set.py",
        "    sync_tree(part)\n",
        "",
        SETS,
    ),
    Line(
        "the names of a new folder not on the disk",
        "io/atomic_write.py",
        "sync_tree(part)",
        "part",
        SETS,
    ),
    # nodes
    Line(
        "a gap counted with its end",
        "nodes/logger_node.py",
        "missing = max(sequence - self.sequence - 1, 0)",
        "missing = max(sequence - self.sequence, 0)",
        LOGGER,
    ),
    Line(
        "messages before the log counted with the first",
        "nodes/logger_node.py",
        "account.before = max(sequence - 1, 0)",
        "account.before = sequence",
        LOGGER,
    ),
    Line(
        "gaps of several publishers counted",
        "nodes/logger_node.py",
        "self.shared = True",
        "self.shared = False",
        LOGGER,
    ),
    Line(
        "the newest stamp never taken",
        "nodes/flow_control.py",
        "self._sent[0][0] <= t_ns",
        "self._sent[0][0] < t_ns",
        FLOW,
    ),
    Line(
        "silence for ever",
        "nodes/flow_control.py",
        "left <= 0.0",
        "left <= -1e9",
        FLOW,
    ),
    Line(
        "an old pass goes on",
        "nodes/stream_passes.py",
        "if t_ns > max(self._newest.values()) + BACK_NS",
        "if t_ns > min(self._newest.values()) - BACK_NS",
        FLOW,
    ),
    Line(
        "covariance of a pose sent as of the body",
        "nodes/convert.py",
        "covariance = T @ states.C_nav @ T.transpose(0, 2, 1)",
        "covariance = T.transpose(0, 2, 1) @ states.C_nav @ T",
        CONVERT,
    ),
    Line(
        "tilt about x and y exchanged",
        "io/cdr.py",
        "[0, 0, 1.0], [0, -1.0, 0]",
        "[0, 1.0, 0], [0, 0, -1.0]",
        CDR,
    ),
    Line(
        "the base's normal mirrored",
        "io/cdr.py",
        "np.array([-slope[0], -slope[1], 1.0])",
        "np.array([slope[0], slope[1], 1.0])",
        CDR,
    ),
)


def seen(line: Line, tree: Path) -> bool:
    """Whether the tests fail with the line in the copy ``tree``."""
    file = tree / "ladar_volume" / line.file
    good = file.read_text(encoding="utf-8")
    if good.count(line.good) < 1:
        raise SystemExit(f"{line.name}: {line.file} has changed, plant it anew")
    with planted_in(file, good.replace(line.good, line.bad, 1)):
        first = sorted(line.tests, key=lambda t: t != HERE)  # the quickest: it often sees the bug
        there = [f"test/{t}" for t in first if (tree / "test" / t).exists()]
        return not passes_all(there, tree)


def count_seen(wanted: list[Line]) -> int:
    """How many are seen; the copy is made in a temporary folder."""
    found = 0
    with tempfile.TemporaryDirectory() as name:
        tree = Path(name) / "tree"
        skip = shutil.ignore_patterns(".git", ".venv", "out", "build", "install")
        shutil.copytree(ROOT, tree, ignore=skip)
        for line in wanted:
            began = time.monotonic()
            there = seen(line, tree)
            took = time.monotonic() - began
            late = took >= SECONDS  # a loaded machine, or a hang: nothing is known
            found += there and not late
            said = "NO END" if late else "seen" if there else "NOT SEEN"
            print(f"{said}: {line.file}: {line.name} ({took:.0f} s)")
            sys.stdout.flush()
    return found


def main() -> int:
    """Plant, and say which were seen."""
    parser = argparse.ArgumentParser(description="one-line bugs by room")
    parser.add_argument("words", nargs="*")
    parser.add_argument("--half", type=int, choices=(0, 1))
    parser.add_argument("--skip", type=int, default=0, help="begin after so many")
    arguments = parser.parse_args()
    words = arguments.words
    wanted = [x for x in LINES if not words or any(w in x.file or w in x.name for w in words)]
    wanted = wanted[arguments.skip :]
    if arguments.half is not None:
        wanted = wanted[arguments.half :: 2]
    found = count_seen(wanted)
    print(f"{found} of {len(wanted)} seen")
    return int(found < len(wanted))


if __name__ == "__main__":
    sys.exit(main())

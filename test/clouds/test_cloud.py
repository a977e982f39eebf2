"""The cloud filter as a whole: closed forms, outliers, invariances, degenerate and hostile clouds,
and the synthetic sets.
"""

from pathlib import Path

import numba
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks import shapes
from ladar_volume.clouds.filter_cloud import REASONS, filter_cloud
from ladar_volume.clouds.sampling.rounding_step import rounding_steps
from ladar_volume.io.pointfiles.cloud_files import read_cloud
from ladar_volume.model.errors import FilterError
from ladar_volume.model.parameters import FilterParameters

DATA = Path(__file__).parents[1] / "data"
TURN = Rotation.random(random_state=5)
SHIFT = np.array([412.3, -777.1, 35.2])
NAMES = ("plane", "sphere", "dihedral 60", "dihedral 120", "cube")


def exact(name, rng):
    """Points (n, 3) on a surface and the distance of others from it."""
    if name == "plane":
        r = np.column_stack([rng.uniform(-1, 1, (2000, 2)), np.zeros(2000)])
        return r, lambda q: np.abs(q[:, 2])
    if name == "sphere":
        r = rng.normal(size=(2500, 3))
        return r / np.linalg.norm(r, axis=1, keepdims=True), lambda q: np.abs(
            np.linalg.norm(q, axis=1) - 1
        )
    shape = shapes.cube(0) if name == "cube" else shapes.dihedral(0, float(name.split()[1]))
    return shape.foot(shape.points[shape.from_surface])[0], shape.distance


@pytest.mark.parametrize("name", NAMES)
def test_surface_without_noise_is_recovered(name):
    r, distance = exact(name, np.random.default_rng(3))
    result = filter_cloud(TURN.apply(r) + SHIFT, FilterParameters(), auto=True)
    assert len(result.index) == len(r)
    # a quadric's frame touches it to a milliradian, which a neighbourhood almost as wide as the
    # sphere shows in the sixth digit
    assert distance(TURN.inv().apply(result.r - SHIFT)).max() < (1e-5 if name == "sphere" else 1e-7)
    assert np.abs(np.linalg.norm(result.normal, axis=1) - 1).max() < 1e-12


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_outliers_go_and_the_plane_stays(share):
    rng = np.random.default_rng(11)
    n = 4000
    r = np.column_stack([rng.uniform(-2, 2, (n, 2)), 0.01 * rng.normal(size=n)])
    bad = rng.random(n) < share
    r[bad, 2] = rng.uniform(-2, 2, bad.sum())
    result = filter_cloud(TURN.apply(r), FilterParameters(), auto=True)
    kept = np.zeros(n, bool)
    kept[result.index] = True
    far = np.abs(r[:, 2]) > 0.05
    assert kept[~bad].mean() > 0.99 and kept[far].mean() < 0.02
    assert np.sqrt(np.mean(TURN.inv().apply(result.r)[~far[result.index], 2] ** 2)) < 0.003
    assert set(result.reason.tolist()) <= set(range(1, len(REASONS)))


def test_order_and_threads_change_no_bit():
    r = shapes.cube(4).points
    one = filter_cloud(r, FilterParameters(), auto=True)
    order = np.random.default_rng(0).permutation(len(r))
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        two = filter_cloud(r[order], FilterParameters(), auto=True)
    finally:
        numba.set_num_threads(threads)
    back = np.argsort(order[two.index])
    assert np.array_equal(order[two.index][back], one.index)
    assert (
        two.r[back].tobytes() == one.r.tobytes()
        and two.sigma[back].tobytes() == one.sigma.tobytes()
    )


def test_the_order_of_a_real_sweep_changes_no_bit():
    """Its coordinates are 32 bits wide, by axis another step, and tell lines and rounding."""
    r = np.asarray(read_cloud(DATA / "automotive.ply").r)
    for seed in range(4):
        mixed = r[np.random.default_rng(seed).permutation(len(r))]
        assert np.array_equal(rounding_steps(mixed), rounding_steps(r))
    r = r[2.0 * np.abs(r[:, 1]) < r[:, 0]]
    order = np.random.default_rng(1).permutation(len(r))
    one, two = (filter_cloud(p, FilterParameters(), auto=True) for p in (r, r[order]))
    back = np.argsort(order[two.index])
    assert np.array_equal(order[two.index][back], one.index)
    for name in ("r", "normal", "sigma", "noise", "flag"):
        assert getattr(two, name)[back].tobytes() == getattr(one, name).tobytes(), name


@pytest.mark.parametrize("far", [[0.0, 0.0, 0.0], [4.5e5, 5.4e6, -9999.0], [4.5e5, 1e30, 0.0]])
def test_a_point_far_away_is_an_outlier_and_changes_nothing_else(far):
    r = shapes.cube(4).points + np.array([4.5e5, 5.4e6, 300.0])
    one = filter_cloud(r, FilterParameters(), auto=True)
    two = filter_cloud(np.vstack([r[:5], far, r[5:]]), FilterParameters(), auto=True)
    reason = dict(zip(two.outliers.tolist(), two.reason.tolist(), strict=True))
    assert REASONS[reason[5]] == "outlier"
    assert two.report["outlier"] == one.report["outlier"] + 1
    assert np.array_equal(two.index - (two.index > 5), one.index)
    assert two.r.tobytes() == one.r.tobytes() and two.sigma.tobytes() == one.sigma.tobytes()


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_motion_and_scale_change_no_figure(scale):
    shape = shapes.dihedral(1, 90.0)
    r = TURN.apply(shape.points) * scale + 1000.0 * scale
    result = filter_cloud(r, FilterParameters(), auto=True)
    back = TURN.inv().apply((result.r - 1000.0 * scale) / scale)
    mine = shape.from_surface[result.index]
    assert np.sqrt(np.mean(shape.distance(back[mine]) ** 2)) < 0.005
    assert mine.sum() > 0.995 * shape.from_surface.sum()
    assert result.report["noise_m"] / scale == pytest.approx(0.0289, rel=0.1)


def test_noise_of_regions_is_told_apart():
    rng = np.random.default_rng(2)
    xy = rng.uniform(-4, 4, (30000, 2))
    noise = np.where(xy[:, 0] < 0, 0.005, 0.02)
    result = filter_cloud(
        np.column_stack([xy, noise * rng.normal(size=len(xy))]), FilterParameters(), auto=True
    )
    assert result.report["least_noise_m"] == pytest.approx(0.005, rel=0.2)
    assert result.report["largest_noise_m"] == pytest.approx(0.02, rel=0.2)
    kept = np.zeros(len(xy), bool)
    kept[result.index] = True
    assert kept[np.abs(xy[:, 0]) > 1].mean() > 0.99


def test_density_of_regions_is_told_apart():
    rng = np.random.default_rng(3)
    xy = np.concatenate(
        [rng.uniform(-4, 4, (8000, 2)), rng.uniform([9.5, -0.5], [10.5, 0.5], (20000, 2))]
    )
    result = filter_cloud(
        np.column_stack([xy, 0.005 * rng.normal(size=len(xy))]), FilterParameters(), auto=True
    )
    assert result.report["least_radius_m"] < 0.5 * result.report["largest_radius_m"]
    assert len(result.index) > 0.99 * len(xy)
    assert np.sqrt(np.mean(result.r[:, 2] ** 2)) < 0.001


def test_sigma_is_the_spread_of_single_points():
    rng = np.random.default_rng(7)
    xy = rng.uniform(-1, 1, (1500, 2))
    error, sigma = [], []
    for _ in range(40):
        z = 0.02 * rng.normal(size=len(xy))
        result = filter_cloud(
            np.column_stack([xy, z]),
            FilterParameters(radius_m=0.25, degree=1),
        )
        inner = (np.abs(result.r[:, :2]) < 0.7).all(axis=1)
        error.append(result.r[inner, 2])
        sigma.append(result.sigma[inner])
    assert np.sqrt(np.mean(np.concatenate(error) ** 2)) == pytest.approx(
        np.sqrt(np.mean(np.concatenate(sigma) ** 2)), rel=0.1
    )


def test_two_sheets_nearer_than_the_radius_are_two():
    rng = np.random.default_rng(8)
    z = np.repeat([0.0, 0.15], 3000)
    r = np.column_stack([rng.uniform(-1, 1, (6000, 2)), z + 0.01 * rng.normal(size=6000)])
    result = filter_cloud(r, FilterParameters(radius_m=0.2, degree=1))
    assert len(result.index) > 0.99 * len(r)
    assert np.sqrt(np.mean((result.r[:, 2] - z[result.index]) ** 2)) < 0.003


def test_points_beyond_an_edge_are_set_on_it_or_go():
    shape = shapes.cube_on_ground(2)  # its noise moves points along the faces too
    snap, remove = (
        filter_cloud(shape.points, FilterParameters(edge=edge), auto=True)
        for edge in ("snap", "remove")
    )
    gone = np.setdiff1d(snap.index, remove.index)
    assert 0 < len(gone) < 0.1 * len(shape.points)
    assert set(remove.reason[np.isin(remove.outliers, gone)].tolist()) == {
        REASONS.index("beyond_edge")
    }
    at = np.isin(snap.index, gone) & shape.from_surface[snap.index]
    assert np.median(shape.distance(snap.r[at])) < 0.015


LINE = np.linspace(0, 1, 50)[:, None]


@pytest.mark.parametrize(
    "r",
    [
        np.zeros((1, 3)),
        np.zeros((2, 3)) + 5.0,
        np.zeros((500, 3)) - 1.0,
        LINE * [1.0, 2.0, 3.0],
        LINE[:5] * [1.0, 0.0, 0.0],
        np.repeat(LINE * [1.0, 1.0, 0.0], 10, axis=0),
        np.random.default_rng(0).random((7, 3)),
        np.array([[0.0, 0, 0], [1e6, 0, 0]]),
    ],
    ids=[
        "one",
        "two alike",
        "all alike",
        "line",
        "short line",
        "line of duplicates",
        "few",
        "far apart",
    ],
)
@pytest.mark.parametrize("auto", [True, False])
def test_what_is_no_surface_is_named(r, auto):
    result = filter_cloud(r, FilterParameters(), auto=auto)
    if auto and np.isin(50, [len(r), len(np.unique(r, axis=0))]):  # a line is too sparse: it stays
        assert result.sparse.all() and not result.verdict.sound
        assert len(result.index) == len(r)
        return
    assert len(result.index) == 0 and np.array_equal(result.outliers, np.arange(len(r)))
    assert set(result.reason.tolist()) <= {
        REASONS.index(why) for why in ("few_neighbours", "no_surface", "unsupported", "outlier")
    }


def test_duplicates_are_kept_with_the_surface():
    rng = np.random.default_rng(9)
    r = np.column_stack([rng.uniform(-1, 1, (1500, 2)), 0.01 * rng.normal(size=1500)])
    result = filter_cloud(np.concatenate([r, r]), FilterParameters(), auto=True)
    # they tell less about the noise than as many single points
    assert len(result.index) > 0.98 * 3000


@pytest.mark.parametrize(
    "bad",
    [
        np.zeros((0, 3)),
        np.zeros((4, 2)),
        np.array([[0.0, 0.0, np.nan]]),
        np.array([[0.0, np.inf, 0.0]]),
    ],
)
def test_no_cloud_is_refused(bad):
    with pytest.raises(FilterError):
        filter_cloud(bad, FilterParameters(), auto=True)


#: RMS and RMS near edges in mm that a set must not exceed in the mean over seeds; the thesis's sets
#: and their relatives.
GOALS = {
    "sphere": (4.5, np.inf),
    "cube": (5.0, 6.5),
    "cube on ground": (7.0, 10.0),
    "dihedral 90 deg": (5.0, 6.5),
    "dihedral 120 deg": (5.0, 6.5),
    "dihedral 150 deg": (5.0, 6.5),
    "apex of 5": (5.0, 6.5),
}


@pytest.mark.parametrize("name", GOALS)
def test_synthetic_sets(name):
    scores = []
    for seed in range(2):
        shape = next(s for s in shapes.every(seed) if s.name == name)
        scores.append(
            shapes.score(shape, filter_cloud(shape.points, FilterParameters(), auto=True))
        )
    mean = {key: np.mean([score[key] for score in scores]) for key in scores[0]}
    assert mean["rms_mm"] <= GOALS[name][0] and not mean["edge_rms_mm"] > GOALS[name][1]
    assert (
        mean["false_removed_pct"] <= 0.5
        and mean["far_removed_pct"] >= 97.0
        and mean["unaccounted"] == 0
    )
    if name == "sphere":
        assert abs(mean["bias_mm"]) <= 0.5


@pytest.mark.parametrize("kind", ["normal", "uniform"])
def test_self_set_noise_is_the_true_one_though_edges_raise_the_first_guess(kind):
    rng = np.random.default_rng(4)
    shape = next(s for s in shapes.every(4) if s.name == "cube")
    foot, _ = shape.foot(shape.points)
    noise = (
        rng.normal(0, 0.02, len(foot)) if kind == "normal" else rng.uniform(-0.03, 0.03, len(foot))
    )
    r = (foot + noise[:, None] * shape.normal)[shape.from_surface]
    result = filter_cloud(r, FilterParameters(), auto=True)
    # a normal noise loses its tails at the threshold
    true, within = (0.02, 0.05) if kind == "normal" else (0.03 / np.sqrt(3), 0.01)
    assert result.report["noise_m"] == pytest.approx(true, rel=within)
    assert len(result.index) > 0.99 * len(r)


def test_a_surface_carried_on_beyond_its_points_is_named():
    """A few stray points beside a plane: what is fitted to them depends on the plane's far end."""
    rng = np.random.default_rng(8)
    plane = np.column_stack([rng.uniform(-1, 1, (3000, 2)), rng.normal(0, 0.01, 3000)])
    stray = np.column_stack(
        [rng.uniform(1.15, 1.5, 12), rng.uniform(-0.2, 0.2, 12), rng.uniform(-0.3, 0.3, 12)]
    )
    r = np.concatenate([plane, stray])
    result = filter_cloud(r, FilterParameters(), auto=True)
    assert (
        np.isin(np.arange(3000, 3012), result.outliers).all()
        and np.isin(np.arange(3000), result.index).mean() > 0.99
    )

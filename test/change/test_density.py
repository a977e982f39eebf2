"""Density, the size rule by error class, and the coastline remark."""

from __future__ import annotations

import numpy as np
import pytest
from closed_meshes import sphere

from ladar_volume.change.density import (
    cube_surface,
    density,
    implied_offset,
    least_cube,
    relative_errors,
    size_rule,
    weighed_mass,
)
from ladar_volume.change.resolution import resolution_series, thin
from ladar_volume.mesh.tetrahedra import closed_variance, closed_volume, surface_area
from ladar_volume.model.errors import VolumeError
from ladar_volume.tin.full_tin import build_tin


@pytest.mark.parametrize(("u", "v"), [(0.01, 0.02), (0.05, 0.08), (0.0, 0.1), (0.1, 0.0)])
def test_density_by_monte_carlo(u, v):
    d = density(16_000.0, 16_000 * u, 16.0, 16 * v)
    rng = np.random.default_rng(1)
    sample = (
        16_000
        * (1 + u * rng.standard_normal(400_000))
        / (16 * (1 + v * rng.standard_normal(400_000)))
    )
    assert d.density_kg_m3 == pytest.approx(1000.0)
    assert np.std(sample) == pytest.approx(d.sigma_kg_m3, rel=0.01)
    assert np.mean(sample) - 1000 == pytest.approx(d.bias_kg_m3, abs=0.6 + 0.05 * d.bias_kg_m3)
    assert sum(d.variance_shares) == pytest.approx(1.0)


def test_the_interval_covers_what_it_says():
    rng, hit = np.random.default_rng(2), 0
    for _ in range(4000):
        m, v = 24_000 + 900 * rng.standard_normal(), 16 + 1.6 * rng.standard_normal()
        low, high = density(m, 900, v, 1.6).interval_kg_m3
        hit += low <= 1500 <= high
    assert hit / 4000 == pytest.approx(0.95, abs=0.01)


def test_exact_inputs_and_refusals():
    d = density(10.0, 0.0, 2.0, 0.0)
    assert (
        d.interval_kg_m3 == (5.0, 5.0) and d.sigma_kg_m3 == 0.0 and d.variance_shares == (0.0, 0.0)
    )
    for bad in (
        (0.0, 1, 1, 0),
        (np.nan, 1, 1, 0),
        (1, -1, 1, 0),
        (1, 0, 1, 0.6),
        (1, 0, -2, 0.1),
        (1, 0, 0, 0),
        (1, 0, np.inf, 0),
    ):
        with pytest.raises(VolumeError):
            density(*bad)


def test_loads():
    m = weighed_mass(np.full(4, 5000.0), 20.0, 0.001)
    assert m.mass_kg == 20_000 and m.sigma_kg == pytest.approx(np.hypot(40, 20))
    for bad in (np.zeros(0), np.array([1.0, np.nan])):
        with pytest.raises(VolumeError):
            weighed_mass(bad, 1.0)


def test_the_size_rule():
    for volume, share in ((1.728, 0.05), (100.0, 0.012927)):
        assert relative_errors(cube_surface(volume), volume, offset_m=0.01)[
            "offset"
        ] == pytest.approx(share, rel=0.002)
    assert least_cube(0.01, 0.05) == pytest.approx(1.728) and implied_offset(
        100.0, 0.05
    ) == pytest.approx(0.0387, abs=1e-4)
    text = " ".join(size_rule())
    assert (
        "5 % at 1.7 m³" in text
        and "1.3 % at 100 m³" in text
        and "more than 100 m³" in text
        and "3.9 cm" in text
    )
    r = 2.0
    assert relative_errors(4 * np.pi * r**2, 4 / 3 * np.pi * r**3, offset_m=0.01)[
        "offset"
    ] == pytest.approx(0.01 * 3 / r)


def test_each_class_falls_with_size_as_it_should():
    kinds = {
        "offset_m": 0.01,
        "noise_m": 0.01,
        "spacing_m": 0.1,
        "correlated_m": 0.01,
        "correlation_length_m": 0.2,
        "scale": 1e-4,
        "height_m": 0.01,
    }
    small = relative_errors(6.0, 1.0, plan_area_m2=1.0, **kinds)
    large = relative_errors(6.0 * 100, 1000.0, plan_area_m2=100.0, **kinds)
    factor = {"offset": 0.1, "noise": 0.01, "correlated": 0.01, "scale": 1.0, "height": 0.1}
    assert {k: large[k] / small[k] for k in factor} == pytest.approx(factor)
    assert relative_errors(6.0, 1.0, correlated_m=0.01, correlation_length_m=50.0)[
        "correlated"
    ] == pytest.approx(0.06)
    for bad in ({"offset_m": -1.0}, {"scale": np.nan}):
        with pytest.raises(VolumeError):
            relative_errors(6.0, 1.0, **bad)
    with pytest.raises(VolumeError):
        relative_errors(0.0, 1.0)


def test_the_noise_class_is_what_the_mesh_says():
    v, t = sphere(2200)
    b = closed_volume(v, t)
    spacing = np.sqrt(b.area_m2 / 2200)
    rule = relative_errors(b.area_m2, b.volume_m3, noise_m=0.01, spacing_m=spacing)["noise"]
    assert np.sqrt(closed_variance(v, b, 0.01).first_m6) / b.volume_m3 == pytest.approx(
        rule, rel=0.03
    )


def rough(size, hurst, seed):
    """Heights (size, size) of a random surface with a power-law spectrum."""
    rng = np.random.default_rng(seed)
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size)))
    k[0, 0] = np.inf
    return np.fft.ifft2(np.fft.fft2(rng.standard_normal((size, size))) * k ** -(hurst + 1)).real


def test_the_surface_of_rubble_grows_and_its_volume_does_not():
    xy = (
        np.stack(np.meshgrid(np.arange(128), np.arange(128)), axis=-1).reshape(-1, 2) + 0.5
    ) * 0.05

    def evaluate(p):
        tin = build_tin(p)
        c = tin.vertices[tin.triangles]
        plan = 0.5 * np.abs(
            np.cross(
                np.c_[c[:, 1, :2] - c[:, 0, :2], np.zeros(len(c))],
                np.c_[c[:, 2, :2] - c[:, 0, :2], np.zeros(len(c))],
            )[:, 2]
        )
        return float(plan @ c[:, :, 2].mean(axis=1) / plan.sum()), surface_area(
            tin.vertices, tin.triangles
        ) / plan.sum()

    out = {}
    rubble = rough(128, 0.3, 3)
    for name, z in (("rubble", rubble / rubble.std() * 0.4 + 3.0), ("slope", 0.7 * xy[:, 0])):
        out[name] = resolution_series(np.c_[xy, z.ravel()], [0.8, 0.05, 0.1, 0.2, 0.4], evaluate)
    assert (np.diff(out["rubble"].points) < 0).all() and out["rubble"].cell_m[0] == 0.05
    assert out["rubble"].dimension > 2.1 and out["slope"].dimension == pytest.approx(2.0, abs=1e-9)
    assert out["slope"].area_m2 == pytest.approx(np.sqrt(1.49))
    assert (
        out["rubble"].volume_change_m3 < 0.05
        and out["rubble"].area_m2[0] > 1.5 * out["rubble"].area_m2[-1]
    )


def test_thinning_does_not_depend_on_the_order():
    p = np.random.default_rng(4).uniform(-3, 3, (500, 3))
    order = np.random.default_rng(5).permutation(500)
    a, b = p[thin(p, 1.0)], p[order][thin(p[order], 1.0)]
    assert {tuple(r) for r in a} == {tuple(r) for r in b} and len(a) <= 216
    for bad, cell in ((p * np.nan, 1.0), (p, 0.0), (p[:0], 1.0)):
        with pytest.raises(VolumeError):
            thin(bad, cell)
    with pytest.raises(VolumeError):
        resolution_series(p, [1.0], lambda q: (1.0, 1.0))
    with pytest.raises(VolumeError):
        resolution_series(p, [1.0, 2.0], lambda q: (1.0, 0.0))

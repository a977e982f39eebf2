"""Every key of a filter is read by the algorithm that it belongs to; a key of another algorithm is
refused in one line that says where it is read.
"""

import dataclasses
import json

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.clouds.filter_cloud import filter_cloud
from ladar_volume.model.cloud_filter_parameters import (
    FILTERS,
    FilterParameters,
    PublishedFilterParameters,
)
from ladar_volume.model.errors import UnknownParameterError
from ladar_volume.model.parameter import read_section, specs
from ladar_volume.model.parameters import Parameters, SurfaceFilterParameters
from ladar_volume.model.records import MappedPoints, PlatformStates
from ladar_volume.rmls.surface_filter import SurfaceFilter

#: Keys of section ``filter`` of versions before each algorithm had a class of its own.
OLD = ("order", "confidence", "grid_before_m", "grid_after_m", "reduce", "edge")


def watched(kind, **values):
    """Parameters that note which of them are read."""
    read = set()

    def note(self, name):
        read.add(name)
        return object.__getattribute__(self, name)

    spy = type(kind.__name__, (kind,), {"__getattribute__": note})(**values)
    read.clear()
    return spy, read


def names(kind):
    return {f.name for f in dataclasses.fields(kind)}


def ground(n=600):
    """Points on a plane with noise of 5 mm, a tenth of them above it."""
    rng = np.random.default_rng(1)
    r = np.column_stack([rng.uniform(0, 1, (n, 2)), rng.normal(0, 0.005, n)])
    r[: n // 10, 2] += rng.uniform(0.1, 0.5, n // 10)
    return r


@pytest.mark.parametrize("kind", FILTERS.values())
def test_a_filter_of_files_reads_every_key_of_its_own(kind):
    parameters, read = watched(kind, radius_m=0.3, trials=5)
    filter_cloud(ground(), parameters)
    assert read & names(kind) == names(kind)


def test_the_live_filter_reads_every_key_of_its_own():
    kind = SurfaceFilterParameters
    parameters, read = watched(kind, radius_m=0.3, trials=5)
    f = SurfaceFilter(dataclasses.replace(Parameters(), filter=parameters))
    r = ground()
    t = np.array([0, 10**9])
    still = np.tile([0.0, 0.0, 0.0, 1.0], (2, 1))
    zero, above = np.zeros((2, 3)), np.tile([0.0, 0.0, 5.0], (2, 1))
    covariance = np.tile(np.eye(6) * 1e-4, (2, 1, 1))
    f.add_platform(PlatformStates(t, above, still, zero, zero, covariance, np.zeros(2, int)))
    n = len(r)
    C = np.tile(np.array([1e-4, 0, 0, 1e-4, 0, 1e-4], np.float32), (n, 1))
    ring, bright = np.zeros(n, np.uint16), np.zeros(n, np.float32)
    f.add(MappedPoints(np.linspace(0, 10**9 - 1, n).astype(np.int64), r, C, ring, bright))
    assert f.finish() is not None
    assert read & names(kind) == names(kind)


def test_old_keys_are_refused_with_the_place_where_they_are_read():
    assert set(SurfaceFilterParameters.elsewhere) == {*OLD, "edges_threshold", "min_share", "sort"}
    for key in OLD:
        with pytest.raises(UnknownParameterError) as caught:
            Parameters.read({"filter": {key: 1}})
        assert f"filter.{key} " in str(caught.value) and "ladar_volume filter" in str(caught.value)
        assert "\n" not in str(caught.value)
    # what an earlier version wrote beside its result
    old = {"filter": {"radius_m": 0.25, **dict.fromkeys(OLD, 1)}}
    assert Parameters.read(old, old=True).filter == SurfaceFilterParameters(radius_m=0.25)
    with pytest.raises(UnknownParameterError):
        Parameters.read({"filter": {"raduis_m": 1}}, old=True)


def test_a_key_has_one_place_or_is_refused():
    every = {s.key for kind in (SurfaceFilterParameters, *FILTERS.values()) for s in specs(kind)}
    for kind in (FilterParameters, PublishedFilterParameters, SurfaceFilterParameters):
        own = {s.key for s in specs(kind)}
        assert own.isdisjoint(kind.elsewhere)
        for key in every - own:
            with pytest.raises(UnknownParameterError, match="alone"):
                read_section(kind, "filter", {key: 1})


def test_what_tables_9_1_and_9_2_print_has_a_door(tmp_path, capsys):
    # k = 20 and 10 points per sample, edgesThreshold, and points as they come
    cloud = tmp_path / "cloud.npy"
    np.save(cloud, ground())
    kept = {}
    for k, edges, sort in ((4, 0.1, "true"), (20, 0.1, "true"), (10, 0.9, "false")):
        words = [
            f"filter.sample_size={k}",
            f"filter.edges_threshold={edges}",
            f"filter.sort={sort}",
        ]
        sets = [w for word in ("filter.order=published", *words) for w in ("--set", word)]
        out = tmp_path / f"{k}.npy"
        given = ["filter", str(cloud), "-o", str(out), "--preset", "bench", *sets, "--json"]
        assert main(given) == 0
        facts = json.loads(capsys.readouterr().out)
        assert facts["parameters"]["sample_size"] == k and facts["parameters"]["sort"] == (k != 10)
        assert facts["report"]["fits_edge"] == 0 or k != 10
        kept[k] = facts["report"]["trials_per_fit"]
    # twenty points without an outlier are rare: the trials run to their end
    assert kept[20] > 2.0 * kept[4]

"""Patches as a table: back as they were, and refused in any other format."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from random_surfaces import random_surface

from ladar_volume.io import message_tables
from ladar_volume.model.errors import CloudError
from ladar_volume.model.records import CAL_COLUMNS, FilterUpdate, Patches


def update(p, seed=0):
    points, patches, _, _ = random_surface(p, seed=seed)
    single = {
        name: np.asarray(getattr(patches, name), np.float32) for name in ("cross", "M_cal", "M_nav")
    }
    rounded = {
        name: np.float64(np.float32(getattr(patches, name)))
        for name in ("centre", "normal", "tangent", "beta", "sigma")
    }
    return FilterUpdate(
        7,
        np.array([5, 9], np.int64),
        points,
        dataclasses.replace(patches, **single, **rounded),
        complete=False,
    )


def with_residuals(sent, seed=1):
    """The update with residuals of its bins, beams and voxels."""
    rng, p = np.random.default_rng(seed), sent.patches
    beams = (p.M_cal.shape[2] - len(CAL_COLUMNS)) // 2
    residuals = {
        "nav_residual": rng.normal(size=len(p.nav_bin)).astype(np.float32),
        "beam_residual": rng.normal(size=(len(p), beams)).astype(np.float32),
        "own_residual": rng.normal(size=len(p)).astype(np.float32),
    }
    return dataclasses.replace(sent, patches=dataclasses.replace(p, **residuals))


@pytest.mark.parametrize("residuals", [False, True])
@pytest.mark.parametrize("p", [3, 6])
def test_there_and_back(p, residuals):
    sent = with_residuals(update(p)) if residuals else update(p)
    back = message_tables.filter_update(sent.points, message_tables.patch_columns(sent))
    assert (back.t_ns, back.complete, back.removed.tolist()) == (7, False, [5, 9])
    for field in dataclasses.fields(Patches):
        mine, theirs = getattr(back.patches, field.name), getattr(sent.patches, field.name)
        assert (
            mine.dtype == theirs.dtype
            and mine.shape == theirs.shape
            and np.array_equal(mine, theirs)
        ), field.name


@pytest.mark.parametrize(
    "kind", ["navigation in two rows", "calibration short", "no end", "no column"]
)
def test_other_formats_are_refused(kind):
    columns = message_tables.patch_columns(update(6))
    if kind == "navigation in two rows":  # position and attitude apart, as once
        rows = np.sort(
            np.r_[
                np.arange(len(columns["kind"])),
                np.flatnonzero(columns["kind"] == message_tables.NAVIGATION),
            ]
        )
        columns = {name: column[rows] for name, column in columns.items()}
        at = np.flatnonzero(columns["kind"] == message_tables.NAVIGATION)
        columns["index"][at[1::2]] = 1
    elif kind == "calibration short":
        columns = {
            name: np.delete(
                column, np.argmax(columns["kind"] == message_tables.CALIBRATION), axis=0
            )
            for name, column in columns.items()
        }
    elif kind == "no end":
        columns = {name: column[:-1] for name, column in columns.items()}
    else:
        columns.pop("values")
    with pytest.raises(CloudError) as caught:
        message_tables.filter_update(update(6).points, columns)
    assert caught.value.reason == {"no end": "cloud_short", "no column": "cloud_fields"}.get(
        kind, "cloud_format"
    )

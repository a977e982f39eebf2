"""Report and field page in headless Chromium, as a phone and as a desktop show them: no error on
the console, every figure there, nothing wider than the screen. The pictures of the docs come of it:
``PICTURES=docs/pictures pytest -n 0 test/report/test_in_browser.py``.
"""

import os
import re

import numpy as np
import pytest
from browser import SIZES, browser

from ladar_volume.cli.main import main

#: Pixels that a canvas has drawn upon.
DRAWN = """(id => {
    const c = document.getElementById(id);
    const all = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
    const one = new Uint32Array(all.buffer);
    return one.filter(p => p !== one[0]).length;
})"""
WIDE = "document.documentElement.scrollWidth - document.documentElement.clientWidth"
#: Width and height of each figure on the page, and how much is drawn in it.
FIGURES = """[...document.querySelectorAll("figure")].map(f => {
    const s = f.querySelector("svg"), box = s.getBoundingClientRect();
    const paths = s.querySelectorAll("path, image, use, polygon").length;
    return [f.id, box.width, box.height, paths];
})"""


def take_picture(page, name, whole=False):
    """Only where somebody asks for the pictures."""
    if "PICTURES" in os.environ:
        page.picture(f"{os.environ['PICTURES']}/{name}.png", whole)


@pytest.fixture(scope="module")
def page():
    with browser() as tab:
        yield tab


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """The report of a cone of 99.5 m³ on its ground."""
    folder = tmp_path_factory.mktemp("report")
    rng = np.random.default_rng(4)
    xy = rng.uniform(-10.0, 10.0, (8000, 2))
    z = np.clip(3.8 - 0.76 * np.hypot(*xy.T), 0.0, None) + rng.normal(0.0, 0.01, len(xy))
    np.savetxt(folder / "cone.xyz", np.c_[xy, z], fmt="%.4f")
    words = ["volume", folder / "cone.xyz", "--base", "ground", "--report", folder / "cone.html"]
    assert main([*map(str, words), "--json"]) == 0
    return folder / "cone.html"


@pytest.mark.parametrize("size", SIZES)
def test_the_report_shows_every_figure(page, report, size):
    page.errors.clear()
    page.open(report.as_uri(), size)
    figures = page.value(FIGURES)
    written = re.findall(r'<figure id="([\w-]+)"', report.read_text(encoding="utf-8"))
    assert [f[0] for f in figures] == written and len(written) >= 3
    for name, width, height, paths in figures:
        assert width > 200 and height > 100 and paths > 3, name
    take_picture(page, f"report_{size}", whole=size == "desktop")
    assert page.value(WIDE) <= 0
    assert page.errors == []


@pytest.mark.parametrize("size", SIZES)
def test_the_field_page_shows_volume_curve_and_map(page, size):
    pytest.importorskip("starlette", reason="the extra 'page' is not installed")
    from ladar_volume.page.feed import Cell, Feed, NodeHealth
    from ladar_volume.page.field_page import address_of, serve_page

    feed = Feed()
    with serve_page(feed, address_of("0", None)) as at:
        page.errors.clear()
        page.open(at.url, size)
        for k in range(20):
            feed.volume(
                {
                    "volume_m3": f"{643.1 + 20.0 / (k + 1):.4f}",
                    "sigma_m3": f"{9.0 / (k + 1):.4f}",
                    "verdict": "doubtful",
                    "doubt_cut": "the pile is cut at 3 m",
                    "seen_share": "0.93",
                    "data_time_ns": str((100 + 2 * k) * 10**9),
                }
            )
        places = [(float(x), float(y)) for x in range(-8, 9) for y in range(-6, 7)]
        cells = [
            Cell(x, y, 3.0, 0.01 + 0.004 * np.hypot(x, y), 0.1, bool(np.hypot(x - 5, y) < 2))
            for x, y in places
        ]
        feed.cells(cells, 1.0)
        for name in ("georeference_node", "filter_node", "volume_node"):
            feed.node(name, NodeHealth("ok", "all is well"))
        page.until('document.getElementById("volume").textContent.includes("644")')
        page.until('document.getElementById("nodes").children.length === 3')
        assert page.value(f'{DRAWN}("curve")') > 500 and page.value(f'{DRAWN}("map")') > 5000
        take_picture(page, f"field_page_{size}")
        assert page.value(WIDE) <= 0
        assert page.errors == []
        page.open("about:blank", size)

"""The report is one file that needs nothing else: every figure is there, nothing is fetched, what
it says is what the JSON says, and its digests are those of the files.
"""

from __future__ import annotations

import hashlib
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from ladar_volume.cli.main import main
from ladar_volume.io.pointfiles.cloud_files import write_cloud


class Page(HTMLParser):
    """Ids, the figures with what they hold, addresses, and the text of a page."""

    def __init__(self, text):
        super().__init__()
        self.ids, self.figures, self.addresses, self.words = [], {}, [], []
        self._figure = None
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        if "id" in given:
            self.ids.append(given["id"])
        for name in ("src", "href", "xlink:href", "action", "data"):
            if name in given:
                self.addresses.append(given[name])
        if tag == "figure":
            self._figure = given["id"]
            self.figures[self._figure] = set()
        elif self._figure:
            self.figures[self._figure].add(tag)

    def handle_endtag(self, tag):
        if tag == "figure":
            self._figure = None

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture(scope="module")
def pile(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pile")
    rng = np.random.default_rng(3)
    xy = rng.uniform(-12, 12, (2500, 2))
    z = 235 + np.maximum(0, 3 - 0.5 * np.hypot(*xy.T)) + 0.01 * rng.normal(size=len(xy))
    write_cloud(folder / "pile <b>.ply", np.c_[xy + np.array([458000, 5430000]), z])
    return folder


@pytest.fixture(scope="module")
def reported(pile):
    cloud, page = pile / "pile <b>.ply", pile / "pile.html"
    words = ["volume", str(cloud), "--base", "ground", "--report", str(page)]
    assert main(words) == 0
    return page.read_text(encoding="utf-8"), json.loads(page.with_suffix(".json").read_text())


def test_every_figure_is_drawn_and_nothing_is_fetched(reported):
    text, twin = reported
    page = Page(text)
    assert set(twin["figures"]) == {
        "heights",
        "cut-fill",
        "sigma",
        "section-1",
        "section-2",
        "budget",
    }
    assert set(page.figures) == {f"figure-{name}" for name in twin["figures"]}
    assert all({"svg", "path"} <= tags for tags in page.figures.values())
    assert all(a.startswith(("#", "data:image/png;base64,")) for a in page.addresses)
    assert not re.search(r"https?:|@import|<script|url\((?!#|&quot;#|\"#)", text)


def test_ids_are_used_once_and_every_reference_has_its_own(reported):
    page = Page(reported[0])
    assert len(page.ids) == len(set(page.ids))
    used = {a[1:] for a in page.addresses if a.startswith("#")}
    used |= set(re.findall(r"url\(#([^)]*)\)", reported[0]))
    assert used <= set(page.ids)


def test_the_page_says_what_the_json_says(reported, pile, capsys):
    text, twin = reported
    assert main(["volume", str(pile / "pile <b>.ply"), "--base", "ground", "--json"]) == 0
    said = capsys.readouterr().out
    assert json.loads(said) == twin["result"]
    words = " ".join(Page(text).words)
    for value in (twin["result"]["net_m3"], *twin["result"]["interval_m3"]):
        assert f"{value:,.3f}" in words
    assert twin["result"]["base"] in words and "no CRS named" in words
    assert "pile <b>.ply" in words and "<b>.ply" not in text
    assert twin["sha256"]["result"] == hashlib.sha256(said.encode()).hexdigest()
    data = (pile / "pile <b>.ply").read_bytes()
    assert list(twin["sha256"]["input"].values()) == [hashlib.sha256(data).hexdigest()]
    assert twin["sha256"]["result"] in words


def test_reasons_of_a_doubtful_volume_stand_in_the_page(tmp_path):
    rng = np.random.default_rng(4)
    xy = rng.uniform(-5, 5, (900, 2))
    z = 0.3 * np.maximum(0, 3 - np.hypot(*xy.T)) + 0.01 * rng.normal(size=900)
    z[::9] += rng.uniform(1, 9, 100)  # a share of strays that no sound cloud has
    write_cloud(tmp_path / "a.ply", np.c_[xy, z])
    page = tmp_path / "a.html"
    assert main(["volume", str(tmp_path / "a.ply"), "--level", "0.1", "--report", str(page)]) == 0
    twin = json.loads(page.with_suffix(".json").read_text())
    assert twin["result"]["verdict"]["status"] == "doubtful"
    words = " ".join(Page(page.read_text()).words)
    assert all(reason["text"] in words for reason in twin["result"]["verdict"]["reasons"])


def test_between_two_clouds_the_second_is_the_base(pile, tmp_path):
    rng = np.random.default_rng(6)
    xy = rng.uniform(-12, 12, (600, 2)) + np.array([458000, 5430000])
    write_cloud(tmp_path / "b.ply", np.c_[xy, np.full(600, 234.0)])
    page = tmp_path / "two.html"
    words = ["volume", str(pile / "pile <b>.ply"), str(tmp_path / "b.ply"), "--report", str(page)]
    assert main(words) == 0
    assert len(Page(page.read_text()).figures) >= 5


def test_a_report_ends_in_html(pile, capsys):
    with pytest.raises(SystemExit):
        main(["volume", str(pile / "pile <b>.ply"), "--level", "0", "--report", "a.pdf"])
    assert "ends in .html" in capsys.readouterr().err

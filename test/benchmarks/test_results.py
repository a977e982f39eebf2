"""RESULTS.md: sections of a run replace those of an earlier one, the others stay."""

from types import SimpleNamespace

from benchmarks import __main__ as bench


def test_sections_are_replaced_one_by_one(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(bench, "HERE", tmp_path)
    figures = {"a": 1.23456, "b": 2, "c": "three"}
    monkeypatch.setattr(
        bench.importlib, "import_module", lambda name: SimpleNamespace(run=lambda: figures)
    )
    assert bench.main(["surface", "filtering"]) == 0
    text = (tmp_path / "RESULTS.md").read_text()
    assert (
        text.index("## filtering") < text.index("## surface") and text.count("| a | 1.235 |") == 2
    )
    figures["a"] = 7.0
    assert bench.main(["surface"]) == 0
    text = (tmp_path / "RESULTS.md").read_text()
    assert (
        text.count("## ") == 2 and text.count("| a | 7 |") == 1 and text.count("| c | three |") == 2
    )
    assert "surface: b: 2" in capsys.readouterr().out


def test_an_unknown_benchmark_is_named(capsys):
    assert bench.main(["nonsense"]) == 2 and "nonsense" in capsys.readouterr().err

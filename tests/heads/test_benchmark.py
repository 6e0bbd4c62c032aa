"""The benchmark of the heads runs from end to end at a small size."""

import importlib.util
import json
import sys
from pathlib import Path

PATH = Path(__file__).parents[2] / "benchmarks" / "heads.py"


def test_the_small_size_measures_every_figure_that_is_to_be_reached(tmp_path, monkeypatch):
    spec = importlib.util.spec_from_file_location("heads_benchmark", PATH)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)  # dataclasses look their module up
    spec.loader.exec_module(module)
    assert module.main(["--quick", "--out", str(tmp_path / "heads.json")]) == 0
    figures = json.loads((tmp_path / "heads.json").read_text())["figures"]
    for key in ("minibootstrap_speedup", "minibootstrap_map_minus_sklearn", "solve_over_limit", "store_ratio"):
        assert f"heads.{key}" in figures
    assert figures["heads.minibootstrap_speedup"]["value"] > 1
    assert figures["heads.solve_over_limit"]["value"] > 0.9  # faster than the limit means that it is miscounted
    assert figures["heads.store_ratio_of_copies"]["value"] > figures["heads.store_ratio"]["value"]

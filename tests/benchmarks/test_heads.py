"""The benchmark of the heads runs from end to end at a small size."""

import json

from icub_benchmarks.heads import run, sweep


def test_the_small_size_measures_every_figure_that_is_to_be_reached(tmp_path):
    assert run.main(["--quick", "--results", str(tmp_path)]) == 0
    figures = json.loads((tmp_path / "heads.json").read_text())["figures"]
    for key in ("minibootstrap_speedup", "minibootstrap_map_minus_sklearn", "solve_over_limit", "store_ratio"):
        assert f"heads.{key}" in figures
    assert figures["heads.minibootstrap_speedup"]["value"] > 1
    assert figures["heads.solve_over_limit"]["value"] > 0.9  # faster than the limit means that it is miscounted
    table = (tmp_path / "heads_sweep.md").read_text()
    assert "| 1000 | 64 | 100 | 3 |" in table
    assert figures["heads.store_ratio_of_copies"]["value"] > figures["heads.store_ratio"]["value"]


def test_a_whole_sweep_is_drawn_and_varies_one_number_at_a_time(tmp_path):
    wanted = sweep.solves(sweep.Sizes())
    assert len(wanted) == sum(map(len, sweep.AXES.values())) - 3
    for solve in wanted:
        assert sum(getattr(solve, axis) != getattr(sweep.BASE, axis) for axis in sweep.AXES) <= 1
    columns = ("s", "sklearn_s", "speedup", "map", "map_difference")
    figures = {f"heads.sweep.{solve.key}.{name}": {"value": 1.0} for solve in wanted for name in columns}
    table, image = sweep.write_report(tmp_path / "heads_sweep", figures)
    assert table.read_text().count("\n| ") == 2 + len(wanted)  # heading and rule
    assert image.read_bytes().startswith(b"\x89PNG")

"""A method from outside: registered here, it runs in a suite and is in every table and picture of the report."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from oimppi_warp.bench.report.figures import success_figure
from oimppi_warp.bench.report.tables import every_table
from oimppi_warp.bench.report.write import write_report
from oimppi_warp.bench.results import load_results
from oimppi_warp.bench.runner import BenchError, SuiteRun
from oimppi_warp.bench.suite import Suite, load_suite
from oimppi_warp.errors import ConfigError
from oimppi_warp.planning.planner import Planner
from oimppi_warp.plots.style import FURTHER_COLORS
from oimppi_warp.registries import METHODS

TINY = """
tasks = ["task01"]
methods = ["mppi", "straight"]
trials = 1
first = 11
max_sim_seconds = 0.2
set = ["robot.optimizer.samples=64", "object.optimizer.samples=64"]
"""


class StraightPlanner(Planner):
    """Plain MPPI by another name."""

    method = "straight"


@pytest.fixture
def registered() -> Iterator[None]:
    METHODS.register("straight", StraightPlanner)
    yield
    METHODS.unregister("straight")


def suite_in(folder: Path) -> Suite:
    (folder / "mine.toml").write_text(TINY)
    return load_suite(folder / "mine.toml")


def test_an_unknown_method_is_refused_with_those_there_are(tmp_path: Path):
    with pytest.raises(ConfigError, match="allowed: a list of names from mppi, soi, cloi"):
        suite_in(tmp_path)


@pytest.mark.usefixtures("registered")
def test_a_registered_method_is_run_and_reported_and_its_results_outlive_it(tmp_path: Path):
    results = SuiteRun(suite_in(tmp_path), tmp_path / "out").execute(jobs=1)
    assert [(r.run.method, r.number, r.error) for r in results.results] == [("mppi", 11, ""), ("straight", 11, "")]
    plain, straight = results.results
    assert straight.pose == plain.pose  # it is plain MPPI, on the same start with the same noise
    assert straight.metrics["method"] == "straight"
    assert "--method straight" in straight.command
    assert (tmp_path / "out" / "trials").exists()
    assert any(folder.name.startswith("task01-straight-011-") for folder in (tmp_path / "out" / "trials").iterdir())

    METHODS.unregister("straight")
    again = load_results(tmp_path / "out")
    page, markdown = (file.read_text() for file in write_report(again, tmp_path / "report"))
    for table in every_table(again)[:4]:
        assert "STRAIGHT" in {row[1] for row in table.rows}, table.title
    assert f'style="--color: {FURTHER_COLORS[0]}">STRAIGHT<b>' in page
    assert "| task01 | STRAIGHT | 0/1 |" in markdown
    legend = success_figure(again).axes[0].get_legend()
    assert legend is not None
    assert "STRAIGHT" in [text.get_text() for text in legend.get_texts()]
    assert FURTHER_COLORS[0] in (tmp_path / "report" / "pictures" / "ways_task01.svg").read_text()


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize("options", [{"jobs": 2}, {}, {"jobs": 1, "backend": "dask"}])
def test_a_method_that_other_processes_do_not_know_is_refused_where_they_would_run_it(tmp_path: Path, options: dict):
    run = SuiteRun(suite_in(tmp_path), tmp_path / "out")
    with pytest.raises(BenchError, match=r"method straight was registered in this process[\s\S]*--jobs 1"):
        run.execute(**options)
    assert not (tmp_path / "out").exists()

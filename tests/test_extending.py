"""docs/extending.md does what it says: its package is installed beside ours and used by its names, ours untouched."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from oimppi_warp.record.log import EpisodeLog
from oimppi_warp.registries import COST_TERMS, ENGINES, METHODS, OPTIMIZERS, PLANTS, SHAPES
from oimppi_warp.usd import load_scene

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
NAMES = [
    (COST_TERMS, "high"),
    (PLANTS, "kinematic"),
    (METHODS, "straight"),
    (OPTIMIZERS, "search"),
    (ENGINES, "careful"),
    (SHAPES, "bracket"),
]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the page's package as pip would install it."""
    folder = tmp_path_factory.mktemp("site")
    for name, code in re.findall(r"```python\n# (my_pushing/\S+)\n(.*?)```", PAGE, flags=re.DOTALL):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(code)
    toml = next(iter(re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)))
    entries = re.sub(r'\[project\.entry-points\."(.*?)"\]', r"[\1]", toml).replace('"', "")
    info = folder / "my_pushing-0.1.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-pushing\nVersion: 0.1\n")
    (info / "entry_points.txt").write_text(entries)
    return folder


def oimppi(site: Path, *arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    paths = os.pathsep.join([str(ROOT), str(site)])
    return subprocess.run(
        [sys.executable, "-m", "oimppi_warp", *arguments],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": paths},
        capture_output=True,
        text=True,
        timeout=280,
    )


def test_the_page_has_an_example_for_every_registry(site: Path):
    assert sorted(path.stem for path in (site / "my_pushing").iterdir()) == [
        "cost", "engine", "method", "optimizer", "plant", "shape",
    ]  # fmt: skip
    for registry, name in NAMES:
        assert (
            f"[{registry.group}]\n{name} = my_pushing."
            in (site / "my_pushing-0.1.dist-info/entry_points.txt").read_text()
        )
        assert name not in registry  # it is not installed here


def test_the_shape_of_the_page_is_pushed_and_stands_in_the_way(site: Path, tmp_path: Path):
    (line,) = re.findall(r"`oimppi (scene new mine .*?)`", PAGE)
    done = oimppi(site, *line.split(), folder=tmp_path)
    assert done.returncode == 0, done.stderr
    scene = load_scene(tmp_path / "mine.usda")
    assert scene.object.rest_height == 0.015
    assert [obstacle.path for obstacle in scene.obstacles] == ["/World/Obstacles/Bracket"]


def test_everything_on_the_page_is_run_together_by_its_names(site: Path, tmp_path: Path):
    chosen = ["--plant", "kinematic", "--method", "straight", "--engine", "careful", "--device", "cpu"]
    settings = [
        "robot.optimizer=search",
        "robot.optimizer.share=0.5",
        "robot.optimizer.samples=64",
        "cost.extra.high=5",
    ]
    done = oimppi(site, "run", "task01", *chosen, "--start", "0", "--max-sim-seconds", "1", "--record", "r",
                  "--json", "m.json", "--set", *settings, folder=tmp_path)  # fmt: skip
    assert done.returncode == 1, done.stderr  # nothing moves this object
    log = EpisodeLog.load(tmp_path / "r")
    assert [log.header[name] for name in ("plant", "method", "engine")] == ["kinematic", "straight", "careful"]
    assert len(log) == 10 and log.header["control_period"] == log.header["config"]["control_period"] == 0.1
    optimizer = log.header["config"]["robot"]["optimizer"]
    assert (optimizer["kind"], optimizer["share"], optimizer["samples"]) == ("search", 0.5, 64)
    assert log.header["config"]["cost"]["extra"]["high"] == 5.0
    # The tip starts above 2 cm, so the term costs; and it is the last of the terms.
    assert log.header["cost_terms"][-1] == "high"
    assert log["cost_terms"][0, -1] > 0.0
    assert json.loads((tmp_path / "m.json").read_text())["mean_cost_terms"]["high"] > 0.0


def test_help_suites_and_the_doctor_know_installed_entries(site: Path, tmp_path: Path):
    said = oimppi(site, "run", "--help", folder=tmp_path).stdout
    for choice in (
        "{mppi,soi,cloi,straight}",
        "{auto,quasistatic,newton,careful}",
        "{ideal,lab,pusht,xarm,ros2,kinematic,FILE.py:NAME}",
    ):
        assert choice in said
    doctor = oimppi(site, "doctor", "--json", folder=tmp_path).stdout
    assert all(f'"{name}": "my-pushing"' in doctor for _, name in NAMES)
    (tmp_path / "mine.toml").write_text(
        'tasks = ["task01"]\nmethods = ["straight", "mppi"]\ntrials = 1\nmax_sim_seconds = 0.2\nplant = "kinematic"\n'
        'engine = "careful"\nset = ["robot.optimizer.samples=64"]\n'
    )
    done = oimppi(site, "bench", "mine.toml", "--jobs", "2", "--no-report", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "STRAIGHT" in done.stdout
    rows = json.loads((tmp_path / "runs/mine/results.json").read_text())["results"]
    assert [(row["method"], row["plant"], row["engine"], row["error"]) for row in rows] == [
        ("straight", "kinematic", "careful", ""), ("mppi", "kinematic", "careful", ""),
    ]  # fmt: skip


def test_the_examples_are_as_long_as_they_are_said_to_be(site: Path):
    """A plant of one's own in twenty lines: statements, not counting imports and docstrings."""
    tree = ast.parse((site / "my_pushing/plant.py").read_text())
    lines = {node.lineno for node in ast.walk(tree) if isinstance(node, ast.stmt)}
    assert len(lines) <= 20

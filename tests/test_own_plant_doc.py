"""docs/own_plant.md does what it says: its examples are run as printed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

from oimppi_warp.plants import plant

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "docs" / "own_plant.md").read_text(encoding="utf-8")


def python(folder: Path, *words: str) -> str:
    """Runs Python in a folder, and returns what it printed."""
    run = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=280,
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


def test_the_complete_plant_pushes_the_disc_to_its_goal(tmp_path: Path):
    (tmp_path / "disc_world.py").write_text(
        re.findall(r"```python\n(# disc_world\.py.*?)```", PAGE, flags=re.DOTALL)[0]
    )
    made, run, viewed = re.findall(r"^oimppi (.*disc.*)$", PAGE, flags=re.MULTILINE)
    assert viewed.startswith("view disc.usda")
    python(tmp_path, "-m", "oimppi_warp", *made.split())
    said = python(tmp_path, "-m", "oimppi_warp", *run.split(), "--method", "mppi", "--device", "cpu")
    assert "goal reached within 200 mm, also within 5 mm" in said
    assert (tmp_path / "runs" / "disc" / "way.png").is_file()


def test_a_gymnasium_environment_is_a_plant_in_a_few_lines(tmp_path: Path):
    for name, code in re.findall(r"```python\n# (\w+\.py)\n(.*?)```", PAGE, flags=re.DOTALL):
        (tmp_path / name).write_text(code)
    class_lines = (tmp_path / "environment_plant.py").read_text().partition("own_world")[2].strip().splitlines()
    assert len([line for line in class_lines if line.strip()]) <= 25
    assert python(tmp_path, "crude_pusht.py").splitlines()[-1] == "success {'reward': 1.0}"


def test_every_optional_member_is_in_the_table():
    protocols = (plant.StreamingPlant, plant.TruthfulPlant, plant.ContactPlant, plant.MovablePlant, plant.JudgingPlant)
    members = {name for each in protocols for name in (*vars(each), *getattr(each, "__annotations__", {}))}
    for name in {name for name in members if not name.startswith("_")} | {"latency", "own_world"}:
        assert f"`{name}`" in PAGE or f"`{name}()`" in PAGE, name

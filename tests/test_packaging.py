"""What a user gets: light imports, public names, pinned packages, every file in its place."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import oimppi_warp
from oimppi_warp.bench.provenance import NO_PART

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
RUNTIME, EXTRAS = (ROOT / name for name in ("requirements.lock", "requirements-extras.lock"))
HEAVY = {"pxr", "viser", "newton", "mujoco", "warp", "matplotlib", "trimesh", "shapely", "scipy"}


def modules_after(code: str) -> set[str]:
    """Top-level modules that a fresh Python has loaded after ``code``."""
    script = f"{code}\nimport sys; print(*sorted({{name.partition('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(done.stdout.split())


@pytest.mark.parametrize(
    "code", ["import oimppi_warp", "import oimppi_warp.cli.main", "from oimppi_warp import best, paper"]
)
def test_importing_stays_light(code: str):
    assert not modules_after(code) & HEAVY


def test_a_run_whose_fields_are_cached_starts_without_the_packages_that_made_them():
    code = """
from oimppi_warp.cli.main import main
arguments = ["run", "task02", "--engine", "quasistatic", "--max-sim-seconds", "0.05", "--device", "cpu"]
assert main([*arguments, "--set", "robot.optimizer.samples=64"]) == 1
print()
"""
    modules_after(code)
    needless = {"newton", "mujoco_warp", "trimesh", "scipy", "networkx", "matplotlib", "viser"}
    assert not modules_after(code) & needless


def test_an_episode_imports_nothing_that_the_hash_of_its_code_leaves_out():
    script = """
import sys
import oimppi_warp.runtime.episode, oimppi_warp.plants.lab, oimppi_warp.runtime.request, oimppi_warp.usd
import oimppi_warp.planning.engines.newton_threads, oimppi_warp.planning.engines.newton_worlds
from oimppi_warp.registries import METHODS
list(METHODS.values())
print(*(name for name in sys.modules if name.startswith("oimppi_warp.")))
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    imported = {name.split(".")[1] for name in done.stdout.split()}
    assert {"config", "planning", "plants", "record", "registry", "runtime"} <= imported
    assert not imported & set(NO_PART)
    assert all((ROOT / "oimppi_warp" / name).is_dir() for name in NO_PART)


def test_importing_takes_less_than_two_seconds():
    script = "import time; t = time.perf_counter(); import oimppi_warp.cli.main; print(time.perf_counter() - t)"
    runs = [
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
        for _ in "ab"
    ]
    assert min(float(run.stdout) for run in runs) < 2.0


@pytest.mark.parametrize("name", oimppi_warp.__all__)
def test_every_public_name_is_there_and_documented(name: str):
    assert getattr(oimppi_warp, name).__doc__


def test_an_unknown_name_says_which_there_are():
    with pytest.raises(AttributeError, match="make_planner"):
        oimppi_warp.plan  # noqa: B018  # pyright: ignore[reportAttributeAccessIssue]


def test_the_version_is_the_same_everywhere():
    assert oimppi_warp.__version__ == PROJECT["project"]["version"]


def locked(lock: Path) -> set[str]:
    """Names of the packages in a lock."""
    return set(re.findall(r"^([a-z0-9-]+)==", lock.read_text(), flags=re.MULTILINE))


def names(requirements: list[str]) -> set[str]:
    """Names of the packages that are required."""
    return {re.split(r"[\[<>=~ ]", requirement)[0] for requirement in requirements}


@pytest.mark.parametrize("lock", [RUNTIME, EXTRAS], ids=lambda lock: lock.name)
def test_a_lock_names_no_index(lock: Path):
    assert not re.search(r"https?://|file:|--(extra-)?index-url|--find-links|--trusted-host", lock.read_text())


@pytest.mark.parametrize("lock", [RUNTIME, EXTRAS], ids=lambda lock: lock.name)
def test_every_locked_package_is_pinned_and_hashed(lock: Path):
    lines = lock.read_text().splitlines()
    entries = re.split(r"\n(?=\S)", "\n".join(line for line in lines if not line.startswith("#")))
    assert len(entries) > 30
    for entry in entries:
        assert re.match(r"[a-z0-9-]+==[\w.]+", entry), entry
        assert re.search(r"--hash=sha256:[0-9a-f]{64}", entry), entry


def test_what_it_takes_to_run_is_locked_in_one_file_and_extras_and_tools_in_the_other():
    runtime = names(PROJECT["project"]["dependencies"] + PROJECT["dependency-groups"]["build"])
    optional = {name: each for name, each in PROJECT["project"]["optional-dependencies"].items() if name != "rerun"}
    extras = {name for each in optional.values() for name in names(each)} - runtime
    assert runtime <= locked(RUNTIME)
    assert {"pytest", "ruff", "distributed", "av"} <= extras <= locked(EXTRAS)
    # What the first needs on Windows only, the second may need everywhere.
    assert not locked(RUNTIME) & locked(EXTRAS) - {"colorama"}


def test_what_builds_the_editable_install_is_what_the_build_system_asks_for():
    assert PROJECT["dependency-groups"]["build"] == PROJECT["build-system"]["requires"]


@pytest.mark.parametrize("name", ["kernels", "scenes"])
def test_the_package_reaches_the_folders_at_the_top_through_relative_links(name: str):
    link = ROOT / "oimppi_warp" / name
    assert link.is_symlink()
    assert link.readlink() == Path("..") / name


def test_every_kind_of_scene_file_is_package_data():
    patterns = {pattern.removeprefix("*") for pattern in PROJECT["tool"]["setuptools"]["package-data"]["*"]}
    assert {path.suffix for path in (ROOT / "scenes").rglob("*") if path.is_file()} - {".pyc", ".py"} <= patterns


def test_every_folder_of_scene_files_is_a_package_that_the_wheel_takes():
    from setuptools import find_namespace_packages

    found = set(find_namespace_packages(str(ROOT), include=["oimppi_warp*"]))
    for folder in {path.parent for path in (ROOT / "scenes").rglob("*.usda")}:
        parts = folder.relative_to(ROOT).parts
        assert ".".join(("oimppi_warp", *parts)) in found


def test_the_citation_is_of_this_version():
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {oimppi_warp.__version__}\n" in citation
    assert "Object-Informed Model Predictive Path Integral Control for Non-Prehensile Robot Manipulation" in citation


def test_the_image_is_made_of_files_that_are_there_and_not_ignored():
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    copied = {
        name for line in lines if line.startswith("COPY ") and "--from" not in line for name in line.split()[1:-1]
    }
    let_through = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert {"requirements.lock", "pyproject.toml", "kernels", "scenes", "oimppi_warp"} <= copied == let_through
    assert all((ROOT / name).exists() for name in copied)


@pytest.mark.skipif(shutil.which("hadolint") is None, reason="hadolint is not installed")
def test_hadolint_finds_nothing_in_the_dockerfile():
    done = subprocess.run(["hadolint", "Dockerfile"], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "")

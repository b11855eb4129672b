"""What somebody gets who has nothing but the wheel: the demo with cold caches, and the notebook (slow)."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    sys.path.insert(0, str(ROOT / "tools"))
    try:
        from check_wheel import make_wheel
    finally:
        sys.path.pop(0)
    return make_wheel(tmp_path_factory.mktemp("wheel"))


def interpreter(version: str) -> str:
    """The Python of a version on the path; the test is skipped where there is none."""
    found = shutil.which(f"python{version}")
    if found is None or subprocess.run([found, "-c", ""], capture_output=True).returncode:
        pytest.skip(f"there is no Python {version}")
    return found


@pytest.mark.parametrize("version", ["3.11", "3.12", "3.13"])
@pytest.mark.parametrize("runner", ["uvx", "pipx"])
def test_the_demo_pushes_from_the_wheel_alone(runner: str, version: str, wheel: Path, tmp_path: Path):
    if (program := shutil.which(runner)) is None:
        pytest.skip(f"there is no {runner}")
    python = interpreter(version)
    source = {"uvx": ["--python", python, "--from", wheel], "pipx": ["run", "--python", python, "--spec", wheel]}
    own = ("PYTHON", "VIRTUAL_ENV", "XDG_", "OIMPPI_", "WARP_", "UV_CACHE", "UV_TOOL", "PIPX_")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(own)}
    home, work = tmp_path / "home", tmp_path / "work"
    home.mkdir()
    work.mkdir()
    environment |= {"HOME": str(home), "PIP_NO_CACHE_DIR": "1"}
    command = [program, *map(str, source[runner]), "oimppi", "demo"]
    done = subprocess.run(command, cwd=work, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "goal reached" in done.stdout and "oimppi view --replay oimppi-demo" in done.stdout
    assert {"episode.npz", "episode.json", "way.png"} <= {path.name for path in (work / "oimppi-demo").iterdir()}
    assert {path.name for path in work.iterdir()} == {"oimppi-demo"}


def test_the_notebook_runs_from_its_first_cell_which_installs_the_wheel(wheel: Path, tmp_path: Path):
    client = pytest.importorskip("nbclient", reason="nbclient is not installed")
    import nbformat
    from jupyter_client import AsyncKernelManager

    place = tmp_path / "environment"
    venv.create(place, with_pip=False)
    (site,) = place.glob("lib/python*/site-packages")
    for path in Path(sysconfig.get_path("purelib")).iterdir():  # all that the wheel needs, so that nothing is loaded
        if "oimppi" not in path.name:
            (site / path.name).symlink_to(path)
    work = tmp_path / "work"
    work.mkdir()
    notebook = nbformat.read(ROOT / "docs" / "first_push.ipynb", as_version=4)
    assert all(not cell.get("outputs") for cell in notebook.cells), "outputs belong into no repository"
    manager = AsyncKernelManager()
    manager.kernel_spec.argv[0] = str(place / "bin" / "python")
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment |= {"OIMPPI_WHEEL": str(wheel), "PATH": f"{place / 'bin'}{os.pathsep}{os.environ['PATH']}"}
    client.NotebookClient(notebook, km=manager, timeout=600).execute(cwd=str(work), env=environment)
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    printed = "".join(output["text"] for output in outputs if output["output_type"] == "stream")
    assert printed.count("goal reached: True") == 2, printed
    pages = [output["data"]["text/html"] for output in outputs if "text/html" in output.get("data", {})]
    assert len(pages) == 2 and all(page.startswith("<iframe srcdoc=") and len(page) > 100_000 for page in pages)
    assert any("image/png" in output.get("data", {}) for output in outputs)

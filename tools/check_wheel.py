"""Tests the wheel: builds it from the source distribution, installs it elsewhere, loads a scene and launches a kernel.

The new environment can import the packages of this one (from the lock files) but not the checkout. Usage:
``python tools/check_wheel.py``; it exits with an error at the first step that fails.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tempfile
import venv
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

SMOKE_TEST = """
from pathlib import Path

import warp
import oimppi_warp
from oimppi_warp.bench.suite import shipped_suites
from oimppi_warp.geometry.fields import build_geometry
from oimppi_warp.usd import shipped_scenes

warp.config.log_level = warp.LOG_WARNING
home = Path(oimppi_warp.__file__).parent
assert home.is_relative_to({prefix!r}), home
names = [scene.name for scene in shipped_scenes()]
assert len(names) >= 8, names
suites = [suite.name for suite in shipped_suites()]
assert len(suites) >= 4, suites
geometry = build_geometry(oimppi_warp.load_scene("task02"), device="cpu")
print(f"installed in {{home}}: {{len(names)}} scenes, {{len(suites)}} suites, phi_2 of task02 computed by a kernel")
"""


IGNORED = shutil.ignore_patterns(".*", "build", "dist", "runs", "*.egg-info", "__pycache__")
"""Files that a clean checkout does not contain: environments, caches and build output."""


def run(*command: object, cwd: Path, env: dict[str, str] | None = None) -> str:
    """Run a command and return its output; on failure, exit this script."""
    done = subprocess.run([str(part) for part in command], cwd=cwd, env=env, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{done.stdout}{done.stderr}\nfailed: {command[0]} {command[1]}")
    return done.stdout


def build(source: Path, out: Path, kind: str) -> Path:
    """Call the build backend (``sdist`` or ``wheel``) in ``source``, and return the file it made."""
    code = f"import setuptools.build_meta as backend; backend.build_{kind}({str(out)!r})"
    run(sys.executable, "-c", code, cwd=source)
    (made,) = out.glob("*.tar.gz" if kind == "sdist" else "*.whl")
    return made


def make_wheel(folder: Path) -> Path:
    """Build the wheel in a folder, from the source distribution of a clean checkout, and return it."""
    checkout, out, unpacked = folder / "checkout", folder / "out", folder / "unpacked"
    out.mkdir()
    shutil.copytree(ROOT, checkout, symlinks=True, ignore=IGNORED)
    with tarfile.open(build(checkout, out, "sdist")) as archive:
        archive.extractall(unpacked, filter="data")
    (source,) = unpacked.iterdir()
    return build(source, out, "wheel")


def main() -> None:
    """Build and install the wheel, then test it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        wheel = make_wheel(folder)
        packed = [Path(member).suffix for member in zipfile.ZipFile(wheel).namelist()]
        size = wheel.stat().st_size // 1024
        print(f"built {wheel.name}: {size} KiB, {packed.count('.py')} modules, {packed.count('.usda')} USD files")

        elsewhere = folder / "elsewhere"
        venv.create(elsewhere, with_pip=False)
        python = elsewhere / "bin" / "python"
        site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip())
        pip = ("-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", site, wheel)
        run(sys.executable, *pip, cwd=folder)
        (site / "locked.pth").write_text(sysconfig.get_path("purelib") + "\n")
        environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
        environment["OIMPPI_CACHE"] = str(folder / "cache")  # empty, so that the kernel is compiled
        print(run(python, "-c", SMOKE_TEST.format(prefix=str(site)), cwd=folder, env=environment), end="")
        print(run(python, "-m", "oimppi_warp", "scenes", cwd=folder, env=environment), end="")


if __name__ == "__main__":
    main()

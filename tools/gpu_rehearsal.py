"""Rehearses the check on a GPU machine without one: the same pack and script, on an emulated GPU, in an empty folder.

The other machine is imitated by a fresh CPython 3.12 with the packages that it is expected to have and no package
index, and by stubs for the profilers. Problems are small: the times printed mean nothing.

Usage: ``python tools/gpu_rehearsal.py [--python python3.12]`` (``make gpu-rehearsal``)
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from gpu_pack import ROOT, pinned

EXPECTED = (
    *("numpy", "scipy", "networkx", "pillow", "joblib", "absl-py", "etils", "fsspec", "zipp", "typing-extensions"),
    *("matplotlib", "contourpy", "cycler", "fonttools", "kiwisolver", "packaging", "pyparsing", "python-dateutil"),
    *("rich", "markdown-it-py", "mdurl", "pygments"),
)
"""Packages of ``requirements.lock`` that a GPU machine is expected to have."""
EXPECTED_EXTRAS = (
    "pytest",
    "pytest-timeout",
    "pytest-xdist",
    "execnet",
    "iniconfig",
    "pluggy",
    "hypothesis",
    "sortedcontainers",
)
"""The same of ``requirements-extras.lock``."""
STUBS = {
    "ncu": """
printf '"ID","Kernel Name","gpu__time_duration.sum"\\n"","","us"\\n"0","stub","1.0"\\n'
while [ "$#" -gt 0 ] && [ "${1##*/python}" = "$1" ]; do shift; done
exec "$@"
""",
    "compute-sanitizer": """
while [ "$#" -gt 0 ] && [ "${1##*/python}" = "$1" ]; do shift; done
"$@" && echo "========= ERROR SUMMARY: 0 errors"
""",
}
"""Profilers that only run the program."""


def imitate(python: str, folder: Path) -> Path:
    """Make an environment like the other machine's; returns its interpreter."""
    subprocess.run([python, "-m", "venv", str(folder)], check=True)
    wanted = folder / "expected.txt"
    extras = pinned(ROOT / "requirements-extras.lock", EXPECTED_EXTRAS)
    wanted.write_text(pinned(ROOT / "requirements.lock", EXPECTED) + extras)
    interpreter = folder / "bin" / "python"
    command = [str(interpreter), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]
    subprocess.run([*command, "--require-hashes", "-r", str(wanted)], check=True)
    for name, script in STUBS.items():
        stub = folder / "bin" / name
        stub.write_text(f"#!/usr/bin/env bash\n{script}")
        stub.chmod(0o755)
    return interpreter


def copy_tree(target: Path) -> None:
    """Copy the files that git knows or would add, as they are."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT,
        capture_output=True,
        check=True,
    )
    for name in filter(None, listed.stdout.decode().split("\0")):
        source = ROOT / name
        if source.exists() or source.is_symlink():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target / name, follow_symlinks=False)


def main() -> int:
    """Pack, unpack and check; returns the exit status of the check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", default="python3.12", help="CPython 3.12 to imitate the other machine with.")
    parser.add_argument("--keep", type=Path, default=ROOT / "build" / "gpu-rehearsal", help="Folder of the pack.")
    parser.add_argument("--budget", type=float, default=900.0, help="Most time for the check [s].")
    arguments = parser.parse_args()
    pack = [sys.executable, str(ROOT / "tools" / "gpu_pack.py"), "--rehearsal", "--out", str(arguments.keep)]
    subprocess.run(pack, check=True)
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        interpreter = imitate(arguments.python, place / "python")
        copy_tree(place / "project")
        command = [str(interpreter), "tools/gpu_check.py", "--out", str(arguments.keep / "out"), "--small"]
        command += ["--parts", str(arguments.keep), "--work", str(place / "work"), "--device", "emulated-gpu"]
        command += ["--budget", f"{arguments.budget:g}"]
        environment = {"HOME": str(place), "PATH": f"{interpreter.parent}{os.pathsep}/usr/bin{os.pathsep}/bin"}
        environment |= {"PIP_NO_INDEX": "1", "LANG": "C.UTF-8"}
        return subprocess.run(command, cwd=place / "project", env=environment, check=False).returncode


if __name__ == "__main__":
    raise SystemExit(main())

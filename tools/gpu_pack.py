"""Packs what a check on a GPU machine needs that reaches no package registry.

The machine is expected to have a CPython 3.12 for x86-64 Linux with the usual scientific packages (NumPy, SciPy,
Matplotlib, Pillow, NetworkX, rich, joblib, absl, etils, pytest). The pack adds the other packages of
``requirements.lock``, kernels compiled ahead for the GPU, distance fields, and plans of this machine's CPU to compare
with. ``tools/gpu_check.py`` unpacks it there.

Usage: ``python tools/gpu_pack.py [--arch 90] [--out .gpu]`` writes ``part-aa``, ``part-ab``, ... into the folder.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    "warp-lang",
    "usd-core",
    "mujoco",
    "mujoco-warp",
    "newton",
    "newton-usd-schemas",
    "shapely",
    "trimesh",
    "daqp",
    "glfw",
    "tyro",
    "typeguard",
    "docstring-parser",
)
"""Packages that such a machine lacks."""
LEFT_OUT = (
    *("viser", "imageio", "msgspec", "websockets", "zstandard", "tqdm", "requests", "certifi", "charset-normalizer"),
    *("idna", "urllib3", "coacd", "cloudpickle", "pyopengl", "colorama", "setuptools", "tzdata"),
)
"""Packages that planning without the viewer and without imports of meshes does not need."""
PLATFORMS = [f"manylinux_2_{minor}_x86_64" for minor in (39, 35, 34, 31, 28, 27, 24, 17)] + ["manylinux2014_x86_64"]
"""Wheel platforms that it can use; pip takes no range of them."""
UNUSED = ("warp/tests", "warp/examples", "newton/tests", "newton/examples", "mujoco_warp/test_data", "bin")
"""Folders of the installed packages that planning does not need."""
PART = 40 << 20
"""Maximum size of a part [B]."""


def pinned(lock: Path, names: tuple[str, ...]) -> str:
    """Return the entries of packages in a lock file, with their hashes.

    Raises:
        ValueError: A package is missing from it.
    """
    entries = re.split(r"\n(?=\S)", lock.read_text())
    found = {re.split(r"[=\[ ]", entry, maxsplit=1)[0]: entry for entry in entries}
    if missing := [name for name in names if name not in found]:
        raise ValueError(f"{lock}: no entry for {', '.join(missing)}")
    return "\n".join(found[name] for name in names) + "\n"


def install(site: Path, scratch: Path) -> None:
    """Install the packages for the other machine's Python into a folder."""
    wanted = scratch / "requirements.txt"
    wanted.write_text(pinned(ROOT / "requirements.lock", PACKAGES))
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-deps"]
    command += ["--require-hashes", "--only-binary=:all:", "--no-compile", "--target", str(site)]
    command += ["--python-version", "3.12", "--implementation", "cp"]
    command += [word for name in ("cp312", "abi3", "none") for word in ("--abi", name)]
    command += [word for name in PLATFORMS for word in ("--platform", name)]
    subprocess.run([*command, "-r", str(wanted)], check=True)
    for folder in UNUSED:
        shutil.rmtree(site / folder, ignore_errors=True)


def compute(step: str, root: Path, *options: str) -> None:
    """Run a step of the check on this machine; the distance fields that it needs stay in the pack."""
    places = {"OIMPPI_CACHE": str(root / "fields"), "PYTHONPATH": str(ROOT)}
    script, found = str(ROOT / "tools" / "gpu_steps.py"), str(root / f"{step}.json")
    subprocess.run([sys.executable, script, step, "--out", found, *options], env=os.environ | places, check=True)


def compress(root: Path, out: Path, *, level: int) -> list[Path]:
    """Write a folder as one compressed archive in parts; returns the parts.

    Raises:
        RuntimeError: It takes more than five parts.
    """
    archive = out / "pack.tar.xz"
    compressor = ["xz", f"-{level}", "--threads=0", "--stdout"]
    with archive.open("wb") as stream:
        pack = subprocess.Popen(["tar", "-C", str(root), "-cf", "-", "."], stdout=subprocess.PIPE)
        subprocess.run(compressor, stdin=pack.stdout, stdout=stream, check=True)
        if pack.wait():
            raise RuntimeError("tar failed")
    parts = []
    with archive.open("rb") as stream:
        while data := stream.read(PART):
            parts.append(out / f"part-a{chr(ord('a') + len(parts))}")
            parts[-1].write_bytes(data)
    archive.unlink()
    if len(parts) > 5:
        raise RuntimeError(f"the pack needs {len(parts)} parts of {PART >> 20} MiB, more than five")
    return parts


def main() -> int:
    """Write the parts and print their sizes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arch", type=int, default=90, help="GPU architecture: 90 for sm_90, as in an H100.")
    parser.add_argument("--out", type=Path, default=ROOT / ".gpu", help="Folder for the parts.")
    parser.add_argument("--rehearsal", action="store_true", help="Pack for an emulated GPU and small problems.")
    arguments = parser.parse_args()
    root = arguments.out / "content"
    arguments.out.mkdir(parents=True, exist_ok=True)
    for part in arguments.out.glob("part-*"):
        part.unlink()
    shutil.rmtree(root / "site", ignore_errors=True)
    (root / "site").mkdir(parents=True)
    print("installing packages for CPython 3.12", flush=True)
    install(root / "site", arguments.out)
    size = ["--small"] if arguments.rehearsal else []
    print("planning on this CPU, for comparison", flush=True)
    compute("reference", root, *size)
    print("compiling kernels, which takes minutes unless they are in the folder from last time", flush=True)
    if arguments.rehearsal:
        compute("kernels", root, *size)
    else:
        for precision in ([], ["--precise"]):
            compute("kernels", root, "--arch", str(arguments.arch), *precision)
    print("compressing", flush=True)
    parts = compress(root, arguments.out, level=1 if arguments.rehearsal else 7)
    for part in parts:
        print(f"{part}: {part.stat().st_size / 2**20:.1f} MiB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

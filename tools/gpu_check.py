"""Checks everything on a GPU within a time budget: correctness, times, memory, episodes, tests and profiles.

It needs Python's standard library only. Each step is a process with a time limit (``tools/gpu_steps.py``), in order of
worth; the results are written to ``gpu.json`` after each. A second run, with the first one's file, takes only what is
missing.

Usage, on a machine with a GPU and the parts that ``tools/gpu_pack.py`` wrote:
``python tools/gpu_check.py --out DIR --parts .gpu [--budget 420]``
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

ROOT = Path(__file__).resolve().parents[1]
STEPS = {
    "facts": 90,
    "plans": 60,
    "newton": 90,
    "times": 120,
    "profile": 120,
    "newton_times": 90,
    "tests": 170,
    "episodes": 90,
}
"""Steps in order of worth, with the most time that each may take [s]; ``tools/gpu_steps.py`` explains them."""
_REHEARSAL = 3.0
"""Factor on these times with small problems, which a CPU computes, perhaps a slow and busy one."""
_RESERVE = 4.0
"""Time kept for ending [s]."""


def unpack(parts: Path, work: Path) -> None:
    """Unpack the parts into a folder, unless they are there already.

    Raises:
        FileNotFoundError: There are no parts.
    """
    files = sorted(parts.glob("part-*"))
    if not files:
        raise FileNotFoundError(f"{parts}: no part-*; tools/gpu_pack.py writes them")
    if (work / "unpacked").exists():
        return
    work.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile() as whole:
        for file in files:
            whole.write(file.read_bytes())
        whole.seek(0)
        with tarfile.open(fileobj=whole, mode="r:xz") as archive:
            archive.extractall(work, filter="fully_trusted")
    (work / "unpacked").touch()


def run(command: list[str], environment: dict[str, str], limit: float, log: IO[str]) -> str:
    """Run a command, and end it and all its children after a time limit; returns how it ended."""
    process = subprocess.Popen(
        command, cwd=ROOT, env=environment, stdout=log, stderr=subprocess.STDOUT, start_new_session=True
    )
    try:
        status = process.wait(limit)
    except subprocess.TimeoutExpired:
        return f"ended after {limit:.0f} s"
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    return "done" if status == 0 else f"exit status {status}"


def check(arguments: argparse.Namespace) -> dict[str, Any]:
    """Run the steps that are missing; returns the record."""
    began = time.monotonic()
    out, work = arguments.out, arguments.work
    out.mkdir(parents=True, exist_ok=True)
    record: dict[str, Any] = {"steps": {}}
    earlier = arguments.resume or work / "gpu.json"
    if earlier.exists():
        record = json.loads(earlier.read_text())
    record.update(command=" ".join(sys.argv), device=arguments.device, small=arguments.small)
    if arguments.parts:
        unpack(arguments.parts, work)
    record["unpacked_s"] = round(time.monotonic() - began, 1)
    paths = [str(work / "site"), str(ROOT), str(ROOT / "tools")]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(paths),
        "WARP_CACHE_PATH": str(work / "kernels"),
        "OIMPPI_CACHE": str(work / "fields"),
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONUNBUFFERED": "1",
    }
    with (out / "log.txt").open("a") as log:
        for name, limit in STEPS.items():
            if arguments.steps and name not in arguments.steps:
                continue
            if record["steps"].get(name, {}).get("ended") == "done":
                continue
            limit *= _REHEARSAL if arguments.small else 1.0
            left = arguments.budget - (time.monotonic() - began) - _RESERVE
            file = work / f"{name}.json"
            file.unlink(missing_ok=True)
            started = time.monotonic()
            if left < 10.0:
                ended = "no time was left"
            else:
                log.write(f"\n===== {name}\n")
                log.flush()
                command = [sys.executable, str(ROOT / "tools" / "gpu_steps.py"), name, "--out", str(file)]
                command += ["--device", arguments.device, "--reference", str(work / "reference.json")]
                command += ["--aside", str(out)]
                command += ["--limit", str(min(limit, left)), *(["--small"] if arguments.small else [])]
                ended = run(command, environment, min(limit, left), log)
            found = json.loads(file.read_text()) if file.exists() else {}
            seconds = round(time.monotonic() - started, 1)
            record["steps"][name] = {"ended": ended, "seconds": seconds, "found": found}
            record["seconds"] = round(time.monotonic() - began, 1)
            for place in (out / "gpu.json", work / "gpu.json"):
                partial = place.with_suffix(".part")
                partial.write_text(json.dumps(record, indent=1) + "\n")
                partial.replace(place)
            print(f"{name}: {ended}, {seconds} s", flush=True)
    return record


def rows(record: dict[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield the lines of the table: step, measurement, value."""

    def flatten(value: Any, path: str) -> Iterator[tuple[str, str]]:
        if isinstance(value, dict):
            for key, each in value.items():
                yield from flatten(each, f"{path}, {key}" if path else key)
        elif isinstance(value, list) and len(value) > 6:
            yield path, f"{len(value)} entries"
        else:
            yield path, f"{value:.4g}" if isinstance(value, float) else str(value)

    for name, step in record["steps"].items():
        yield name, step["ended"], f"{step['seconds']} s"
        for path, value in flatten(step["found"], ""):
            yield "", path, value


def main() -> int:
    """Check, and print a table; the exit status is 0 if every step ended well and found nothing wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="Folder for gpu.json and log.txt.")
    parser.add_argument("--parts", type=Path, help="Folder with the parts; without, the packages must be installed.")
    parser.add_argument("--work", type=Path, default=Path("/tmp/oimppi-gpu"), help="Folder to unpack into.")
    parser.add_argument("--budget", type=float, default=420.0, help="Most time for everything [s].")
    parser.add_argument("--device", default="cuda:0", help="Warp device.")
    parser.add_argument("--resume", type=Path, help="gpu.json of an earlier run, whose finished steps are kept.")
    parser.add_argument("--steps", nargs="*", choices=list(STEPS), help="Steps to run. (default: all)")
    parser.add_argument("--small", action="store_true", help="Use small problems, for a rehearsal.")
    arguments = parser.parse_args()
    arguments.out, arguments.work = arguments.out.resolve(), arguments.work.resolve()
    record = check(arguments)
    print()
    for step, what, value in rows(record):
        print(f"{step:14} {what[:90]:90} {value[:60]}")
    problems = [
        f"{name}: {problem}" for name, step in record["steps"].items() for problem in step["found"].get("problems", [])
    ]
    problems += [f"{name}: {step['ended']}" for name, step in record["steps"].items() if step["ended"] != "done"]
    print(f"\n{record['seconds']} s of {arguments.budget:.0f} s;", "problems:" if problems else "no problems")
    for problem in problems:
        print(f"  {problem}")
    return 1 if problems else 0


if __name__ == "__main__":
    raise SystemExit(main())

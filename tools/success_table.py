"""Success of the methods on the shipped tasks, one episode a seed, as ``oimppi run TASK --seed N`` runs them.

python tools/success_table.py --tasks task01 task02 --methods mppi soi cloi --seeds 10 [--json FILE]
python tools/success_table.py --tasks task02 --methods cloi --set cost.w_reach=0
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed

from oimppi_warp.config import Method
from oimppi_warp.log import to_json, versions, write_whole
from oimppi_warp.planner import METHODS

TASKS = ("task01", "task02", "task03", "task03_wide", "task04", "task05", "lab01", "lab02")


def run(task: str, method: Method, seed: int, options: list[str]) -> dict[str, Any]:
    """The metrics of one episode."""
    import warp as wp

    from oimppi_warp import Episode, best, load_scene, summarize
    from oimppi_warp.config import set_option
    from oimppi_warp.feasibility import draw_start

    warnings.filterwarnings("ignore")
    wp.config.log_level = wp.LOG_ERROR
    scene = load_scene(task)
    scene = scene.with_start(draw_start(scene, seed))
    config = best(method)
    for option in options:
        config = set_option(config, option)
    log = Episode(scene, config, method=method, device="cpu", seed=seed).run()
    return to_json(summarize(log))


def row(task: str, method: str, found: list[dict[str, Any]]) -> str:
    """One line of the table."""
    good = [m for m in found if m["success"]]
    times = [m["success_time_s"] for m in good]
    failed = [str(m["seed"]) for m in found if not m["success"]]
    cells = [
        task,
        method.upper(),
        f"{len(good)}/{len(found)}",
        f"{sum(m['success_tight'] for m in found)}/{len(found)}",
        f"{np.median(times):.1f}" if times else "-",
        f"{1e3 * min(m['min_clearance_m'] for m in good):.0f}" if good else "-",
        f"{np.median([m['plan_ms_median'] for m in found]):.1f}",
        ", ".join(failed) or "-",
    ]
    return "| " + " | ".join(cells) + " |"


def main() -> int:
    """Runs the table; exit status 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=TASKS)
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=METHODS)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--set", nargs="+", default=[], help="settings, as for oimppi run")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()

    jobs = [
        (task, method, seed) for task in options.tasks for method in options.methods for seed in range(options.seeds)
    ]
    found = Parallel(n_jobs=options.jobs, return_as="generator")(delayed(run)(*job, options.set) for job in jobs)
    print(
        "| task | method | success | tight | median time to success [s] | least clearance [mm] | plan [ms] | failed |"
    )
    print("|---|---|---|---|---|---|---|---|", flush=True)
    results, batch = [], []
    for job, metrics in zip(jobs, found, strict=True):
        batch.append(metrics)
        if job[2] == options.seeds - 1:
            print(row(job[0], job[1], batch), flush=True)
            results += batch
            batch = []
    if options.json:
        machine = {"processor": platform.processor() or platform.machine(), "cores": os.cpu_count()}
        summary = {"command": " ".join(sys.argv[1:]), "machine": machine, "versions": versions(), "episodes": results}
        write_whole(options.json, (json.dumps(summary, indent=1) + "\n").encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Formats the benchmark's record as tables, for the terminal and as Markdown for ``docs/performance.md``.

Usage: ``python tools/bench_tables.py docs/results/performance.json`` prints the Markdown.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

Table = tuple[str, list[str], list[list[str]]]
"""Title, columns, rows."""

PLAIN = "plain MPPI (robot level alone)"

COLUMNS = {"samples": "K", "horizon": "H", "substeps": "substeps", "median_ms": "median [ms]"}
"""Heading of each column of a sweep, by its name in the record."""

ARITHMETIC = {
    "tip": "motion of the tip, within its bounds",
    "clearance": "clearance of the arm",
    "approach": "approach of the object",
    "contact, looked for": "search for contact",
    "stance": "stance of the tool",
    "costs": "cost terms",
    "gflops": "rate of the kernel [GFLOP/s]",
    "kernel_peak_gflops": "kernel peak [GFLOP/s]",
    "vector_peak_gflops": "vector peak [GFLOP/s]",
    "of_kernel_peak": "rate as a fraction of the kernel peak",
    "of_vector_peak": "rate as a fraction of the vector peak",
}
"""Words for each number of the arithmetic, by its name in the record."""


def tables(record: dict[str, Any]) -> list[Table]:
    """Build all tables of a record."""
    found: list[Table] = []
    cores, samples = record["machine"]["cores"], record["samples"]
    levels = record["quasistatic"]
    rows = []
    for name, level in levels.items():
        one, most = level["one core"], level["all cores"]
        rows.append([name, _ms(one["median_ms"]), _ms(most["median_ms"]), f"{level['ratio']:.2f}", _ms(most["p95_ms"])])
    columns = ["", "1 core [ms]", f"{cores} cores [ms]", "ratio", f"p95, {cores} cores [ms]"]
    title = f"Quasi-static engine, K {samples}, H 25 at the robot level and 60 at the object level"
    found.append((title, columns, rows))

    names = list(levels["robot level"]["one core"]["stage_ms"])
    rows = []
    for stage in names:
        cells = []
        for level in ("robot level", "object level"):
            for count in ("one core", "all cores"):
                cells.append(_ms(levels[level][count]["stage_ms"].get(stage)))
        rows.append([stage, *cells])
    heads = [f"{level}, {n} [ms]" for level in ("robot", "object") for n in ("1 core", f"{cores} cores")]
    found.append(("Stages of these plans, each level alone", ["", *heads], rows))

    newton = record["newton"]
    plan, raw = newton["plan"], newton["raw mujoco.rollout"]
    rows = [["plan", _ms(plan["median_ms"]), _ms(plan["p95_ms"])], ["raw mujoco.rollout", _ms(raw["median_ms"]), ""]]
    rows += [["ratio", f"{newton['ratio']:.3f}", ""]]
    rows += [[f"of the plan: {stage}", _ms(ms), ""] for stage, ms in plan["stage_ms"].items()]
    found.append(
        (f"Newton engine, {PLAIN}, {cores} cores, K {samples}, H 25, {newton['substeps']} substeps",
         ["", "median [ms]", "p95 [ms]"], rows)
    )  # fmt: skip

    found += sweep_tables(record["sweeps"], f"{cores} cores", newton["substeps"])

    draws = record["randomized"]
    rows = [[name, _ms(draws[name]["median_ms"])] for name in ("off", "4 draws")] + [["ratio", f"{draws['ratio']:.2f}"]]
    title = f"Randomized rollouts, quasi-static engine, {PLAIN}, {cores} cores, K {samples}, H 25"
    found.append((title, ["", "median [ms]"], rows))

    sums = record["arithmetic"]
    parts = sums["operations_per_step"].items()
    rows = [[f"operations per step: {ARITHMETIC.get(part, part)}", f"{count}"] for part, count in parts]
    rows += [[ARITHMETIC.get(name, name), f"{sums[name]:g}"] for name in sums if name != "operations_per_step"]
    title = f"Arithmetic of the quasi-static engine's kernel, {PLAIN}, one core, K {samples}, H 25"
    found.append((title, ["", ""], rows))
    rows = [[name, f"{value:,.0f}"] for name, value in record["memory"].items()]
    found.append((f"Memory, H 25, {newton['substeps']} substeps", ["", "bytes"], rows))
    if record["start"]:
        rows = [
            [engine, f"{times['cold_s']:.1f}", f"{times['warm_s']:.1f}"] for engine, times in record["start"].items()
        ]
        title = "Start to end of `oimppi run` with one control step, CLOI, K 64 at the robot level"
        found.append((title, ["", "cold caches [s]", "warm caches [s]"], rows))
    for name, gpu in record.get("gpus", {}).items():
        found += gpu_tables(name, gpu, samples, newton["substeps"])
    return found


def gpu_tables(device: str, gpu: dict[str, Any], samples: int, substeps: int) -> list[Table]:
    """Return the tables of a GPU: plan times with their stages, and sweeps."""
    rows = []
    for plan, entry in gpu["plans"].items():
        stages = ", ".join(f"{stage} {_ms(ms)}" for stage, ms in entry["stage_ms"].items())
        rows.append([plan, _ms(entry["median_ms"]), _ms(entry["p95_ms"]), stages])
    title = f"{device}, K {samples} and H 25 at the robot level"
    found: list[Table] = [(title, ["", "median [ms]", "p95 [ms]", "stages [ms]"], rows)]
    return found + sweep_tables(gpu["sweeps"], device, substeps)


def sweep_tables(sweeps: dict[str, list[dict[str, float]]], where: str, substeps: int) -> list[Table]:
    """Return a table for each sweep.

    Args:
        sweeps: Rows of each sweep, by its title: ``ENGINE over QUANTITY``.
        where: Cores or device, for the titles.
        substeps: Substeps of the Newton engine in the sweeps over other quantities.
    """
    found: list[Table] = []
    for title, entries in sweeps.items():
        heads = list(entries[0])
        engine, _, quantity = title.partition(" over ")
        words = [{"quasistatic": "Quasi-static engine", "newton": "Newton engine"}[engine] + f" over {quantity}"]
        words += [PLAIN, where]
        if "horizon" not in heads:
            words.append("H 25")
        if engine == "newton" and "substeps" not in heads:
            words.append(f"{substeps} substeps")
        columns = [COLUMNS[head] for head in heads]
        found.append((", ".join(words), columns, [[f"{entry[head]:g}" for head in heads] for entry in entries]))
    return found


def print_tables(record: dict[str, Any]) -> None:
    """Print all tables to the terminal."""
    from rich.console import Console
    from rich.table import Table as Grid

    console = Console()
    for title, columns, rows in tables(record):
        grid = Grid(title=title, title_justify="left")
        for index, column in enumerate(columns):
            grid.add_column(column, justify="right" if index else "left")
        for row in rows:
            grid.add_row(*row)
        console.print(grid)


def markdown(record: dict[str, Any]) -> str:
    """Format all tables as Markdown."""
    parts = []
    for title, columns, rows in tables(record):
        lines = [f"| {' | '.join(cells)} |" for cells in (columns, ["---", *["---:"] * (len(columns) - 1)], *rows)]
        parts.append(f"**{title}**\n\n" + "\n".join(lines))
    return "\n\n".join(parts)


def _ms(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}" if value < 100 else f"{value:.0f}"


if __name__ == "__main__":
    print(markdown(json.loads(Path(sys.argv[1]).read_text())))

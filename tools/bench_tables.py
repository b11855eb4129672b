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
    found.append((f"Quasi-static engine, K {samples}", columns, rows))

    names = list(levels["robot level"]["one core"]["stage_ms"])
    rows = []
    for stage in names:
        cells = []
        for level in ("robot level", "object level"):
            for count in ("one core", "all cores"):
                cells.append(_ms(levels[level][count]["stage_ms"].get(stage)))
        rows.append([stage, *cells])
    heads = [f"{level}, {n} [ms]" for level in ("robot", "object") for n in ("1 core", f"{cores} cores")]
    found.append(("Stages", ["", *heads], rows))

    newton = record["newton"]
    plan, raw = newton["plan"], newton["raw mujoco.rollout"]
    rows = [["plan", _ms(plan["median_ms"]), _ms(plan["p95_ms"])], ["raw mujoco.rollout", _ms(raw["median_ms"]), ""]]
    rows += [["ratio", f"{newton['ratio']:.3f}", ""]]
    rows += [[f"of the plan: {stage}", _ms(ms), ""] for stage, ms in plan["stage_ms"].items()]
    found.append(
        (f"Newton engine, {cores} threads, K {samples}, H 25, {newton['substeps']} substeps",
         ["", "median [ms]", "p95 [ms]"], rows)
    )  # fmt: skip

    found += sweep_tables(record["sweeps"])

    draws = record["randomized"]
    rows = [[name, _ms(draws[name]["median_ms"])] for name in ("off", "4 draws")] + [["ratio", f"{draws['ratio']:.2f}"]]
    found.append((f"Randomized rollouts, quasi-static, K {samples}, {cores} cores", ["", "plan [ms]"], rows))

    sums = record["arithmetic"]
    rows = [[f"operations per step: {part}", f"{count}"] for part, count in sums["operations_per_step"].items()]
    rows += [[name.replace("_", " "), f"{sums[name]:g}"] for name in sums if name != "operations_per_step"]
    found.append(("Arithmetic of the fused kernel, one core", ["", ""], rows))
    found.append(("Memory", ["", "bytes"], [[name, f"{value:,.0f}"] for name, value in record["memory"].items()]))
    if record["start"]:
        rows = [
            [engine, f"{times['cold_s']:.1f}", f"{times['warm_s']:.1f}"] for engine, times in record["start"].items()
        ]
        found.append(("Start to end of a run of one control step", ["", "cold caches [s]", "warm caches [s]"], rows))
    for name, gpu in record.get("gpus", {}).items():
        found += gpu_tables(name, gpu, samples)
    return found


def gpu_tables(device: str, gpu: dict[str, Any], samples: int) -> list[Table]:
    """Return the tables of a GPU: plan times with their stages, and sweeps."""
    rows = []
    for plan, entry in gpu["plans"].items():
        stages = ", ".join(f"{stage} {_ms(ms)}" for stage, ms in entry["stage_ms"].items())
        rows.append([plan, _ms(entry["median_ms"]), _ms(entry["p95_ms"]), stages])
    found: list[Table] = [(f"{device}, K {samples}, H 25", ["", "median [ms]", "p95 [ms]", "stages [ms]"], rows)]
    return found + sweep_tables(gpu["sweeps"], f"{device}: ")


def sweep_tables(sweeps: dict[str, list[dict[str, float]]], prefix: str = "") -> list[Table]:
    """Return a table for each sweep."""
    found: list[Table] = []
    for title, entries in sweeps.items():
        heads = list(entries[0])
        title = f"{prefix}{title}" if prefix else f"{title[0].upper()}{title[1:]}"
        found.append((title, heads, [[f"{entry[head]:g}" for head in heads] for entry in entries]))
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

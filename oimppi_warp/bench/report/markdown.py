"""Writes the report as Markdown, with its figures as separate files."""

from __future__ import annotations

from typing import Any

from oimppi_warp.bench.report.tables import Table, every_table, failures, rate
from oimppi_warp.bench.results import ResultSet
from oimppi_warp.bench.statistics import wilson


def write_markdown(results: ResultSet, pictures: dict[str, tuple[str, str]]) -> str:
    """Returns the whole report as Markdown.

    Args:
        results: The results to report.
        pictures: Caption and file of each figure, by name.
    """
    lines = [f"# {results.title}", "", *facts(results), ""]
    for table in every_table(results):
        lines += [f"## {table.title}", "", table.note, "", *markdown_table(table), ""]
    lines += ["## Figures", ""]
    for caption, file in pictures.values():
        lines += [f"![{caption}]({file})", "", f"*{caption}*", ""]
    lines += ["## Failures", "", *_failures(results), ""]
    return "\n".join(lines).rstrip() + "\n"


def write_comparison(table: Table, pairs: Table) -> str:
    """Returns the comparison of two result sets, and the pairs that differ, as Markdown."""
    lines = [f"# {table.title}", "", table.note, "", *markdown_table(table), ""]
    if pairs.rows:
        lines += [f"## {pairs.title}", "", pairs.note, "", *markdown_table(pairs), ""]
    return "\n".join(lines).rstrip() + "\n"


def markdown_table(table: Table) -> list[str]:
    """Formats a table as lines of Markdown, with numbers right-aligned."""
    rule = "|---|---|" + "---:|" * (len(table.header) - 2)
    lines = ["| " + " | ".join(table.header) + " |", rule]
    return lines + ["| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in table.rows]


def facts(results: ResultSet) -> list[str]:
    """Describes in a few sentences how the results were made."""
    found = results.results
    succeeded = wilson(sum(result.success for result in found), len(found))
    count = f"{rate(succeeded)} trials succeeded" if found else "no trials have finished yet"
    text = [f"Suite `{results.suite}`: {count}."]
    if len(found) < results.planned:
        text.append(f"**Incomplete:** {results.planned - len(found)} of {results.planned} trials have not been run.")
    if raised := sum(bool(result.error) for result in found):
        text.append(f"**Failed with an error: {raised}**; these trials count as failures.")
    if len(results.codes) > 1:
        text.append(
            f"**Produced by {len(results.codes)} versions of the code** ({', '.join(results.codes)}); run the suite in "
            "a new folder to get all results from one version."
        )
    if drawn := dict.fromkeys(filter(None, map(_numbers, results.entries))):
        text.append(f"Trials {'; '.join(drawn)}.")
    kinds = dict.fromkeys(
        f"{r.preset}, engine {r.run.engine}, mode {r.run.mode}, plant {' '.join((r.run.plant, *r.run.plant_options))}"
        for r in found
    )
    changed = dict.fromkeys(filter(None, map(_changed, results.entries)))
    if changed:
        text.append(f"Changed settings: {'; '.join(changed)}.")
    machines = dict.fromkeys(result.machine for result in found)
    packages = ", ".join(f"{name} {version}" for name, version in results.versions.items())
    text.append(
        f"Preset {'; '.join(kinds)}. Run on {'; '.join(machines)}. Code version {', '.join(results.codes)}; {packages}."
    )
    return text


def _numbers(entry: dict[str, Any]) -> str:
    """Describes the trial numbers and the seed of an entry; empty if the numbers start at 0 and the seed is 0."""
    first, seed = entry.get("first", 0), entry.get("seed", 0)
    return f"numbered {first} to {first + entry['trials'] - 1}, seed {seed}" if first or seed else ""


def _changed(entry: dict[str, Any]) -> str:
    """Describes the settings that an entry of the suite changes."""
    changes = [f"`{assignment}`" for assignment in entry.get("set", [])]
    if (limit := entry.get("max_sim_seconds")) is not None:
        changes.append(f"at most {limit:g} simulated seconds")
    if (tolerance := entry.get("tolerance")) is not None:
        changes.append(f"tolerance {tolerance[0]:g} m, {tolerance[1]:g} rad")
    if not changes:
        return ""
    return ", ".join(changes) + (f" ({entry['label']})" if entry.get("label") else "")


def _failures(results: ResultSet) -> list[str]:
    found = failures(results)
    if not found:
        return ["None."]
    lines = ["Causes are inferred from the logs. Each command reruns its trial with the same result.", ""]
    for result in found:
        name = f"{result.task}, {result.run.method.upper()}, start {result.number}"
        lines += [
            f"- **{name}**: {result.cause} ({result.evidence})",
            "",
            f"      {result.command}",
            "",
        ]
    return lines

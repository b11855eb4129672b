"""The page and the Markdown: everything is in them, and nothing points elsewhere."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
from support.sample_results import make_one, make_set
from support.synthetic_episode import make_log

from oimppi_warp.bench import paper
from oimppi_warp.bench.report.figures import every_figure
from oimppi_warp.bench.report.markdown import facts
from oimppi_warp.bench.report.tables import (
    brief_table,
    every_table,
    failures,
    paper_table,
    safety_table,
    score_table,
    shown_methods,
    success_table,
    time_table,
)
from oimppi_warp.bench.report.write import write_report
from oimppi_warp.bench.results import ResultSet, load_results
from oimppi_warp.bench.suite import Published
from oimppi_warp.config.run_spec import RunSpec
from oimppi_warp.plots.style import method_colors
from oimppi_warp.record.log import LogError

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"

TRACE = 'Traceback (most recent call last):\n  File "a.py", line 1\nRuntimeError: the <sky> fell\n'


@pytest.fixture(scope="module")
def results() -> ResultSet:
    found = [
        make_one(task, method, number, success=(number + len(method)) % 3 > 0)
        for task in ("task01", "task02", "lab01", "lab02")
        for method in ("mppi", "cloi", "soi")
        for number in range(3)
    ]
    return make_set([*found, make_one("task01", "cloi", 3, error=TRACE)], planned=40)


@pytest.fixture(scope="module")
def written(results: ResultSet, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str, Path]:
    page, markdown = write_report(results, tmp_path_factory.mktemp("report"))
    return page.read_text(), markdown.read_text(), page.parent


def test_the_page_has_no_external_resource(written: tuple[str, str, Path]):
    page, _, _ = written
    assert not re.search(r"https?:|//[a-z]|@import|<script|<link|url\(", page)
    sources = re.findall(r'src="([^"]{0,40})', page)
    assert len(sources) == 3 + 4
    assert all(source.startswith("data:image/svg+xml;base64,") for source in sources)


def test_every_table_is_in_both(results: ResultSet, written: tuple[str, str, Path]):
    page, markdown, _ = written
    tables = every_table(results)
    titles = [table.title for table in tables]
    assert titles == [
        "Success and position error",
        "Exactness",
        "The paper's Table I",
        "The paper's Table II",
        "Time and planning",
        "Clearance and forces",
        "Comparison of methods",
    ]
    for table in tables:
        assert f"## {table.title}\n" in markdown
        assert table.title.replace("'", "&#x27;") in page
        for row in table.rows:
            assert "| " + " | ".join(row) + " |" in markdown
            assert len(row) == len(table.header)


def test_every_failure_is_in_both_with_its_cause_and_command(results: ResultSet, written: tuple[str, str, Path]):
    page, markdown, _ = written
    failed = failures(results)
    assert len(failed) > 5
    for result in failed:
        assert result.cause and result.command in markdown
        assert result.command in page
        assert f"- **{result.task}, {result.run.method.upper()}, start {result.number}**: {result.cause}" in markdown
    assert page.count("<details>") == len(failed)
    assert "the &lt;sky&gt; fell" in page


def test_what_is_missing_and_what_raised_is_said(written: tuple[str, str, Path]):
    page, markdown, _ = written
    assert "**Incomplete:** 3 of 40 trials have not been run." in markdown
    assert "<b>Failed with an error: 1</b>" in page
    assert "A made-up suite &amp; its &lt;results&gt;" in page


def test_changed_settings_are_said(results: ResultSet):
    entries = [{}, {"set": ["cost.w_d=3"], "max_sim_seconds": 5.0, "label": "short"}]
    text = "\n".join(facts(replace(results, entries=entries)))
    assert "Changed settings: `cost.w_d=3`, at most 5 simulated seconds (short)." in text
    assert "Changed settings" not in "\n".join(facts(results))


def test_trials_that_are_not_the_first_are_said(results: ResultSet):
    text = "\n".join(facts(replace(results, entries=[{"first": 10, "trials": 5, "seed": 3}])))
    assert "Trials numbered 10 to 14, seed 3." in text
    assert "Trials" not in "\n".join(facts(results))


def test_results_of_two_codes_are_said(results: ResultSet):
    other = replace(results.results[0], code="other")
    text = "\n".join(facts(replace(results, results=[other, *results.results[1:]])))
    assert "**Produced by 2 versions of the code** (c0de, other)" in text


def test_the_pictures_of_the_markdown_are_there(written: tuple[str, str, Path]):
    _, markdown, folder = written
    files = re.findall(r"\]\((pictures/\w+\.svg)\)", markdown)
    assert len(files) == 7
    for file in files:
        assert (folder / file).read_bytes().startswith(b"<?xml")


def test_the_papers_numbers_stand_beside_ours(results: ResultSet):
    rows = {(row[0], row[1]): row for row in paper_table(results, "I").rows}
    # Table I: SOI on task 02 is 1.0 (0.34 m, of successes 0.34 m, 2.39 Hz, 134 s (87 s)).
    assert rows["task02", "SOI"][2::2] == ("1.0", "0.34", "0.34", "2.39", "134 (87)")
    good = [one for one in results.of("task01", "mppi") if one.success]
    assert 0 < len(good) < len(results.of("task01", "mppi"))
    expected = sum(one.error_until_success_m for one in good) / len(good)
    assert rows["task01", "MPPI"][6:8] == ("0.35", f"{expected:.2f}")
    assert rows["task01", "MPPI"][3].startswith("0.")
    assert not any(task == "mean" for task, _ in rows)  # only two of the five tasks were run
    hardware = {(row[0], row[1]): row for row in paper_table(results, "II").rows}
    assert hardware["mean", "CLOI"][2] == "0.90"
    assert hardware["lab02", "MPPI"][2] == "0.4"


@pytest.mark.parametrize("method", ["mppi", "cloi", "soi"])
def test_the_papers_means_are_those_of_its_rows(method: str):
    for table, tasks in paper.TABLES.items():
        rows = [paper.REPORTED[task, method] for task in tasks]
        mean = paper.MEANS[table, method]
        assert mean.success == pytest.approx(sum(row.success for row in rows) / len(rows), abs=0.0051)
        of_successes = sum(row.success * (row.error_success_m or 0.0) for row in rows) / sum(
            row.success for row in rows
        )
        assert mean.error_success_m == pytest.approx(of_successes, abs=0.016)
        if table == "I":
            assert mean.error_m == pytest.approx(sum(row.error_m or math.nan for row in rows) / 5, abs=0.011)


def test_results_are_read_back_as_they_were(results: ResultSet, tmp_path: Path):
    results.save(tmp_path / "results.json")
    again = load_results(tmp_path)
    assert again.results[0] == results.results[0]
    assert len(again.results) == len(results.results)
    assert [table.rows for table in every_table(again)] == [table.rows for table in every_table(results)]
    assert (tmp_path / "results.json").stat().st_size < 8000 * len(results.results)


def test_results_of_earlier_versions_are_read_and_have_device_and_threads(results: ResultSet, tmp_path: Path):
    results.save(tmp_path / "results.json")
    facts = json.loads((tmp_path / "results.json").read_text())
    for row in facts["results"]:
        del row["device"], row["threads"]
        row["metrics"].pop("threads", None)
    (tmp_path / "results.json").write_text(json.dumps(facts))
    again = load_results(tmp_path)
    assert again.results[0].run == results.results[0].run == RunSpec("mppi", "quasistatic", "cpu", 1, 0)
    assert [table.rows for table in every_table(again)] == [table.rows for table in every_table(results)]


@pytest.mark.parametrize("name", sorted(path.name for path in RESULTS.glob("*.json") if '"suite"' in path.read_text()))
def test_the_committed_results_are_read_and_reported(name: str):
    results = load_results(RESULTS / name)
    if (found := len(results.results)) < results.planned:
        page = " ".join((RESULTS.parent / "results.md").read_text().split())
        assert f"{found} of the suite's {results.planned} trials" in page
    (success, *_) = every_table(results)
    assert len(success.rows) == len({(result.task, result.run.method) for result in results.results})
    assert all(result.run.device == "cpu" and result.run.threads == 1 for result in results.results)
    ahead = {method for _, method, _, _, total, *_ in time_table(results).rows if "(" in total}
    plans_ahead = "soi" in results.methods and not name.startswith(("pusht", "paper-newton"))  # < PLANNED_AHEAD there
    assert ("SOI" in ahead) is plans_ahead and "MPPI" not in ahead


def test_scores_of_the_plant_stand_above_those_that_others_published(tmp_path: Path):
    def scored(result, **scores: float):
        return replace(result, metrics=result.metrics | {"best_scores": scores})

    good, bad = make_one(number=0), make_one(number=1, success=False)
    found = make_set([scored(good, coverage=0.99, reward=1.0), scored(bad, coverage=0.5, reward=0.6)])
    assert score_table(make_set([good, bad])).rows == ()
    others = (Published("Policy", "a paper", 0.638, {"coverage": 0.959}), Published("Other", "a card"))
    found = replace(found, note="Ours knows the model.", published=others)
    found.save(tmp_path / "results.json")
    found = load_results(tmp_path)
    table = score_table(found)
    assert table.header[4:6] == ("largest coverage, mean", "largest reward, mean")
    assert table.rows[0][:6] == ("task01", "CLOI", "1/2", "9 to 91 %", "0.745", "0.800")
    assert table.rows[1] == ("a paper", "Policy", "63.8 %", "-", "0.959", "-", "-", "-")
    assert table.rows[2] == ("a card", "Other", "-", "-", "-", "-", "-", "-")
    assert table.note.endswith("were published by others. Ours knows the model.")
    page, markdown = write_report(found, tmp_path)
    for text in (page.read_text(), markdown.read_text()):
        assert "Ours knows the model." in text and "a paper" in text
    # A trial that raised an error has scored nothing.
    raised = replace(found, results=[*found.results, make_one(number=2, error=TRACE)])
    assert score_table(raised).rows[0][4] == "0.497"


def test_methods_that_are_not_the_papers_are_shown_after_them_with_colours_of_their_own(tmp_path: Path):
    methods = ("soi", "mine", "mppi", "yours", "cloi")
    found = make_set([make_one(method=method, number=number) for method in methods for number in range(2)])
    shown = ["mppi", "cloi", "soi", "mine", "yours"]
    assert shown_methods(found) == shown
    colors = method_colors(shown)
    assert len(set(colors.values())) == 5
    titles = [method.upper() for method in shown]
    for table in (success_table(found), paper_table(found, "I"), time_table(found), safety_table(found)):
        assert [row[1] for row in table.rows] == titles
    mine = paper_table(found, "I").rows[3]
    assert mine[2::2] == ("-", "-", "-", "-", "-")
    assert mine[3].startswith("1.00")
    figures = {name: figure for name, (_, figure) in every_figure(found).items()}
    for figure in (figures["success"], figures["errors"]):
        legend = figure.legends[0] if figure.legends else figure.axes[0].get_legend()
        assert legend is not None
        assert [text.get_text() for text in legend.get_texts() if text.get_text() != "paper"] == titles
    assert [axes.get_title(loc="left") for axes in figures["plan_times"].axes] == titles
    assert [axes.get_title(loc="left").split()[0] for axes in figures["ways_task01"].axes] == titles
    page, markdown = (file.read_text() for file in write_report(found, tmp_path))
    assert page.index(">SOI<b>") < page.index(">MINE<b>") < page.index(">YOURS<b>")
    assert page.count(f"--color: {colors['mine']}") == 1
    assert f'background: {colors["yours"]}"></span>YOURS</td>' in page
    assert "| task01 | MINE | 2/2 |" in markdown


def test_what_was_planned_ahead_is_told_whoever_did_it():
    ahead = make_one(method="mine")
    ahead = replace(ahead, metrics=ahead.metrics | {"preplan_time_s": 3.0, "total_time_s": 8.0})
    rows = {row[1]: row[4] for row in time_table(make_set([ahead, make_one(method="cloi")])).rows}
    assert rows["MINE"] == "8.0 (3.0)"
    assert "(" not in rows["CLOI"]


def test_the_record_of_one_run_is_no_result_of_a_suite(tmp_path: Path):
    with pytest.raises(LogError, match="the record of one run, not the results of a suite"):
        load_results(make_log(steps=5).save(tmp_path / "run"))
    with pytest.raises(LogError, match=r"results of a suite \(results\.json: No such file or directory\)"):
        load_results(tmp_path)


def test_the_table_in_the_terminal_explains_its_columns():
    table = brief_table(make_set([make_one(method="cloi")]))
    for name in table.header[3:]:
        assert f"{name.split(' [')[0]}: " in table.note, name


@pytest.mark.parametrize("content", ["", "{}", '{"format": 99}', "[1]"])
def test_a_file_that_has_no_results_is_refused(content: str, tmp_path: Path):
    file = tmp_path / "results.json"
    file.write_text(content)
    with pytest.raises(LogError, match="cannot be read as the results of a suite"):
        load_results(file)


def test_a_report_needs_no_successes_and_no_steps(tmp_path: Path):
    found = [make_one(success=False, steps=0), make_one(method="soi", error=TRACE)]
    page, _ = write_report(make_set(found), tmp_path)
    assert "no steps were run" in page.read_text()

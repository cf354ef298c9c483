"""Analysis: reading answers from files of all kinds, filtering raters, and the numbers, against independent ones."""

from __future__ import annotations

import csv
import json
import re

import numpy as np
import pytest
from hydra.utils import instantiate
from scipy.special import expit
from sklearn.linear_model import LogisticRegression

from grabnet.cli.entry import compose
from grabnet.errors import UserError
from grabnet.study.agreement import krippendorff_alpha
from grabnet.study.analysis import AnalysisConfig, analyse
from grabnet.study.answers import Answer, Answers
from grabnet.study.filtering import FilterConfig, judge
from grabnet.study.key import ALL, CATCH, Shown
from grabnet.study.pairs import bradley_terry, strengths
from grabnet.study.report import run
from grabnet.study.scores import Ratings, scores
from tests.study.conftest import made_key, record_of

RULE = FilterConfig(level=3, share=0.2, least=1)


def config(*values: str) -> AnalysisConfig:
    cfg = compose("study/analyse", ["model=null", "draws=200", *values])
    return instantiate(cfg, _convert_="all")


@pytest.fixture
def study(tmp_path):
    key = made_key()
    key.write(tmp_path / "study")
    return key, tmp_path / "study"


def write_records(folder, records) -> None:
    path = folder / "private/answers.jsonl"
    path.write_text("".join((r if isinstance(r, str) else json.dumps(r)) + "\n" for r in records))


def judging(key, number: int, session: int, **more) -> dict:
    """A rater who sees through catch trials."""
    record = record_of(key, number, session) | more
    for answer in record["answers"]:
        answer["answer"] = 1 if key.is_catch(answer["videos"]) else 4 + session % 2
    return record


def write_csv(path, lines) -> str:
    with path.open("w", newline="") as file:
        csv.writer(file).writerows(lines)
    return f"answers={path}"


def test_what_is_wrong_in_records_is_named_and_left_out(study):
    key, folder = study
    good, other = judging(key, 0, 1), judging(key, 1, 2, platform={"PROLIFIC_PID": "p2", "STUDY_ID": "s"})
    odd = judging(key, 2, 3)
    odd["answers"][0]["answer"] = 9
    odd["answers"][1]["videos"] = ["<script>alert(1)</script>"]
    odd["answers"][2] = {"videos": odd["answers"][2]["videos"]}
    twice = judging(key, 3, 4)
    twice["answers"].append(twice["answers"][0])
    differing = judging(key, 4, 5)
    differing["answers"].append(differing["answers"][0] | {"answer": 2})
    short = judging(key, 5, 6)
    del short["answers"][-2:]
    records = [
        good, other, "{cut o", good, good | {"list": 1, "answers": []}, judging(key, 0, 7, study="f" * 16),
        judging(key, 2, 8, platform={"PROLIFIC_PID": "p2"}), odd, twice, differing, short, "", '{"study": NaN}',
    ]  # fmt: skip
    write_records(folder, records)
    found = analyse(config(f"export={folder}"))
    per_rater = {j.rater: j.answers for j in found.judged}
    n = len(key.lists[0])
    assert per_rater == {f"{1:032x}": n, "p2": n, f"{3:032x}": n - 3, f"{4:032x}": n, f"{5:032x}": n - 1,
                         f"{6:032x}": n - 2}  # fmt: skip
    said = "\n".join(found.answers.problems)
    for sentence in (
        "answers.jsonl, line 3: it is no JSON; the record is left out",
        "line 4: its session has given the same answers before",
        "line 5: its session has given other answers before",
        "line 6: it is of another study",
        "line 7: rater p2 has taken part before",
        "line 8, answer 1: an answer must be a whole number, 1 to 5; it is left out",
        "line 8, answer 2: an answer is to a video that this study does not have",
        "line 8, answer 3: an answer must have the fields",
        f"line 8: 3 of {n} trials have no answer that counts",
        "2 times; the first counts",
        "2 times; as they differ, all are left out",
        f"line 11: 2 of {n} trials have no answer that counts",
        "line 13: a number is not finite",
    ):
        assert sentence in said
    assert "script" not in said and found.conditions == key.conditions


def test_the_papers_rule():
    videos = {f"c{k}": Shown("o", CATCH, k) for k in range(10)} | {"g": Shown("o", "Ground truth", 0)}

    def rows(rater, catches, levels):
        return [Answer(rater, (f"c{k}",), level) for k, level in zip(range(catches), levels, strict=True)]

    given = [
        *rows("one of ten", 10, [3, *[2] * 9]), *rows("two of ten", 10, [3, 5, *[1] * 8]),
        *rows("one of five", 5, [1, 1, 1, 1, 4]), *rows("none", 5, [2] * 5), Answer("no catch", ("g",), 1),
    ]  # fmt: skip
    judged = {j.rater: j for j in judge(Answers(given, videos, []), RULE)}
    assert {name for name, j in judged.items() if j.is_kept} == {"one of ten", "none"}
    assert judged["two of ten"].reason == "took 2 of 10 catch trials for plausible"
    assert judged["no catch"].reason == "answered 0 catch trials, not 1"
    pair = [Answer("p", ("g", "c0"), 1), Answer("p", ("c1", "g"), 1)]
    assert judge(Answers(pair, videos, []), RULE)[0].missed == 1


def test_plain_csv(tmp_path):
    lines = [["rater", "object", "condition", "grasp", "rating", "note"]]
    for rater in ("ann", "bob"):
        lines += [[rater, "mug", "generated", g, 2 + g, ""] for g in range(3)]
        lines += [[rater, "mug", "gt", g, "Agree" if g else "5.0", ""] for g in range(3)]
        lines += [[rater, "mug", "catch", 0, 1, ""]]
    lines += [
        ["", "mug", "gt", 4, 3, ""], ["ann", "mug", "gt", 5, 6, ""], ["ann", "mug", "gt", 6, "=1+1", ""],
        ["ann", "mug", "gt", 7, "", ""], ["ann", "mug", "gt", "x", 3, ""], ["ann", "mug"],
        ["ann", "mug", "gt", 0, 5, ""],
        ["ann", "mug", "gt", 8, "\x1b[2J", ""], ["ann", "mug", "gt", 9, 4.5, ""],
    ]  # fmt: skip
    found = analyse(config(write_csv(tmp_path / "a.csv", lines)))
    assert found.conditions == ["gt", "generated"] and found.kept == ["ann", "bob"]
    assert found.score("gt", "mug").mean.value == pytest.approx((5 + 4 + 4) / 3)
    assert found.score("generated", ALL).mean.value == pytest.approx(3)
    said = "\n".join(found.answers.problems)
    assert said.count("it is left out") == 8 and "line 16: it names no rater" in said and "\x1b" not in said
    assert "'=1+1' is no answer from 1 to 5" in said and "'6' is no answer" in said and "has 2 fields" in said
    assert "a.csv, line 2:" not in said and "2 times; the first counts" in said


@pytest.mark.parametrize("delimiter", [";", "\t", ","])
def test_csv_as_spreadsheets_write_it(delimiter, tmp_path):
    """With a mark of the byte order, carriage returns, any delimiter, and names that are code elsewhere."""
    odd = r"""<b>"x"</b> $\frac & 50 %"""
    path = tmp_path / "odd.csv"
    with path.open("w", newline="", encoding="utf-8-sig") as file:
        writer = csv.writer(file, delimiter=delimiter, lineterminator="\r\n")
        writer.writerow(["rater", "object", "condition", "grasp", "rating"])
        for rater in ("a;b", "a,b"):
            for grasp in range(3):
                writer.writerows([[rater, odd, "Ground truth", grasp, 5], [rater, odd, odd, grasp, 2 + grasp]])
            writer.writerow([rater, odd, "Catch", 0, 1])
        writer.writerows([["a;b", "all", odd, 0, 1], ["a;b", odd, "example", 0, 1]])
    assert run(config(f"answers={path}", f"output={tmp_path / 'out'}")) == 1
    summary = json.loads((tmp_path / "out/analysis.json").read_text())
    assert summary["raters"] == {"all": 2, "kept": 2} and len(summary["left_out"]) == 2
    assert "no object can be called all, and no condition example" in summary["left_out"][0]
    means = {(s["object"], s["condition"]): s["mean"]["value"] for s in summary["scores"]}
    assert means == {(o, c): m for o in (odd, ALL) for c, m in (("Ground truth", 5.0), (odd, 3.0))}
    page = (tmp_path / "out/report.html").read_text()
    assert "<b>" not in page and "&lt;b&gt;" in page


WORDS = ["Strongly disagree", "disagree", "", "agree", "strongly agree"]
BATCHES = {
    "number": (["Answer.rating"], lambda level: [str(level)]),
    "words": (["Answer.rating"], lambda level: [WORDS[level - 1]]),
    "levels": (
        [f"Answer.rating.{k}" for k in range(1, 6)],
        lambda level: ["true" if k == level else "false" for k in range(1, 6)],
    ),
    "json": (
        ["Answer.taskAnswers"],
        lambda level: [json.dumps([{"rating": {str(k): k == level for k in range(1, 6)}}])],
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", BATCHES)
def test_batches_of_mechanical_turk(kind, tmp_path):
    columns, answer = BATCHES[kind]
    videos = [["video", "object", "condition", "grasp"], ["mug_gt_01.mp4", "mug", "gt", 1]]
    videos += [["mug_net_01.mp4", "mug", "net", 1], ["bad.mp4", "mug", "catch", 1]]
    write_csv(tmp_path / "videos.csv", videos)
    lines = [["HITId", "WorkerId", "AssignmentStatus", "Input.video_url", *columns]]
    for worker in ("A1", "A2"):
        for video, level in (("mug_gt_01", 5), ("mug_net_01", 4), ("bad", 1)):
            lines.append(["h", worker, "Approved", f"https://host/x/{video}.mp4?a=1", *answer(level)])
    lines.append(["h", "A3", "Rejected", "https://host/x/bad.mp4", *answer(1)])
    lines.append(["h", "A2", "Submitted", "https://host/x/other.mp4", *answer(1)])
    lines.append(["h", "A4", "Approved", "https://host/bad.mp4", *["" for _ in columns]])
    source = write_csv(tmp_path / "Batch_1_results.csv", lines)
    found = analyse(config(source, f"videos={tmp_path / 'videos.csv'}"))
    assert found.score("gt", ALL).mean.value == 5 and found.score("net", ALL).mean.value == 4
    assert [row.rater for row in found.answers.rows] == ["A1"] * 3 + ["A2"] * 3
    said = found.answers.problems
    assert len(said) == 3 and "was rejected" in said[0] and "is no video of this study" in said[1]
    assert "it has no answer" in said[2]


def test_a_batch_with_several_videos_an_assignment(tmp_path):
    write_csv(tmp_path / "v.csv", [["video", "object", "condition", "grasp"], ["a", "o", "gt", 0], ["b", "o", "net", 0],
                                   ["c", "o", "catch", 0]])  # fmt: skip
    lines = [["WorkerId", *(f"Input.video{k}" for k in (1, 2, 3)), *(f"Answer.rating{k}" for k in (1, 2, 3))],
             ["w", "a", "b", "c", 4, 3, 1]]  # fmt: skip
    found = analyse(config(write_csv(tmp_path / "b.csv", lines), f"videos={tmp_path / 'v.csv'}"))
    assert {row.videos[0]: row.answer for row in found.answers.rows} == {"a": 4, "b": 3, "c": 1}


def test_files_that_are_none_are_one_sentence(tmp_path, study):
    key, folder = study
    (tmp_path / "latin.csv").write_bytes("rater,größe\n".encode("latin-1"))
    (tmp_path / "no.csv").write_text("a,b\n1,2\n")
    (tmp_path / "twice.csv").write_text("rater,rater\n")
    (tmp_path / "nul.csv").write_bytes(b'rater,rating,video\n"a\x00,1')
    (tmp_path / "x.txt").write_text("")
    write_records(folder, ["{}"])
    for values, sentence in [
        (["answers=nowhere.csv"], "does not exist"),
        ([f"answers={tmp_path}/latin.csv"], "is no CSV in UTF-8"),
        ([f"answers={tmp_path}/no.csv"], "needs the columns rater, rating"),
        ([f"answers={tmp_path}/twice.csv"], "two columns of one name"),
        ([f"answers={tmp_path}/nul.csv"], "is no CSV in UTF-8|No answer counts"),
        ([f"answers={tmp_path}/x.txt"], "of no kind that is read"),
        ([f"answers={folder}/private/answers.jsonl"], "name its study, export="),
        ([f"export={folder}"], r"No answer counts in \S+answers.jsonl: answers.jsonl, line 1"),
        ([f"export={folder}", "filter.level=6"], "filter.level is 6; the answers of this study are 1 to 5"),
        ([], "Name what to analyse"),
        ([f"export={folder}", "filter.share=0"], "filter.share is 0; it must be above 0"),
    ]:
        with pytest.raises(UserError, match=sentence):
            analyse(config(*values))
    write_records(folder, [record_of(key, 0, 1)])
    with pytest.raises(UserError, match="None of 1 raters is left: took"):
        analyse(config(f"export={folder}"))
    with pytest.raises(UserError, match="reference=x is none of the conditions"):
        analyse(config(f"export={folder}", "reference=x"))


def test_means_deviations_and_intervals():
    """Against numpy, and the interval against redrawing whole studies from known distributions."""
    rng = np.random.default_rng(1)
    raters, grasps = 30, 12

    def drawn_study():
        quality = {c: rng.normal(m, 0.4, grasps) for c, m in (("gt", 3.4), ("net", 3.0))}
        bias = rng.normal(0, 0.5, raters)
        videos = {f"{c}{g}": Shown("o", c, g) for c in quality for g in range(grasps)}
        rows = [
            Answer(f"r{r}", (f"{c}{g}",), int(np.clip(np.rint(quality[c][g] + bias[r] + rng.normal(0, 0.7)), 1, 5)))
            for r in range(raters) for c in quality for g in range(grasps)
        ]  # fmt: skip
        return Answers(rows, videos, [])

    answers = drawn_study()
    ratings = Ratings.of(answers, ["gt", "net"], 5)
    found = {(s.condition, s.object): s for s in scores(ratings, 400, 0)}
    values = np.array([row.answer for row in answers.rows if row.videos[0].startswith("net")])
    assert found["net", "o"].mean.value == pytest.approx(values.mean()) and found["net", "o"].n == len(values)
    assert found["net", ALL].std == pytest.approx(values.std(ddof=1))
    difference = found["net", ALL].difference
    assert difference.value == pytest.approx(found["net", ALL].mean.value - found["gt", ALL].mean.value)
    repeated = [Ratings.of(drawn_study(), ["gt", "net"], 5) for _ in range(150)]
    differences = [r.rating[r.condition == 1].mean() - r.rating[r.condition == 0].mean() for r in repeated]
    assert 0.75 < difference.drawn.std() / np.std(differences) < 1.5
    # Wider by far than if all ratings were independent.
    independent = np.sqrt(2) * values.std() / np.sqrt(len(values))
    assert np.diff(difference.interval)[0] > 2 * 1.96 * 1.8 * independent


def test_krippendorffs_published_example():
    """Krippendorff, "Computing Krippendorff's alpha-reliability" (2011), part C: ordinal .815."""
    table = """1 2 3 3 2 1 4 1 2 . . .
               1 2 3 3 2 2 4 1 2 5 . 3
               . 3 3 3 2 3 4 2 2 5 1 .
               1 2 3 3 2 4 4 1 2 5 1 ."""
    rows = [line.split() for line in table.splitlines()]
    unit, rating = zip(*[(u, int(v)) for row in rows for u, v in enumerate(row) if v != "."], strict=True)
    assert krippendorff_alpha(np.array(unit), np.array(rating), 5) == pytest.approx(0.815, abs=5e-4)
    assert np.isnan(krippendorff_alpha(np.array([1, 2]), np.array([1, 2]), 5))
    assert krippendorff_alpha(np.array([1, 1, 2, 2]), np.array([1, 1, 5, 5]), 5) == 1


def test_bradley_terry_is_the_logistic_regression():
    rng = np.random.default_rng(0)
    wins = rng.integers(3, 40, (4, 4)).astype(float)
    np.fill_diagonal(wins, 0)
    i, j = np.nonzero(wins)
    design = np.eye(4)[i] - np.eye(4)[j]
    design, target = np.concatenate([design, -design]), np.repeat([1, 0], len(i))
    weights = np.tile(wins[i, j], 2)
    regression = LogisticRegression(fit_intercept=False, C=1e9, tol=1e-10, max_iter=1000)
    regression.fit(design[:, 1:], target, sample_weight=weights)
    np.testing.assert_allclose(bradley_terry(wins)[1:], regression.coef_[0], atol=1e-4)
    assert bradley_terry(np.stack([wins, wins.T])).shape == (2, 4)


def test_pairs_give_strengths():
    rng = np.random.default_rng(2)
    videos = {f"{c}{g}": Shown("o", c, g) for c in ("gt", "net", CATCH) for g in range(20)}
    rows = []
    for r in range(40):
        for g in range(20):
            left, right = (f"gt{g}", f"net{g}") if rng.random() < 0.5 else (f"net{g}", f"gt{g}")
            better = 1 if left.startswith("gt") else 2
            rows.append(Answer(f"r{r}", (left, right), better if rng.random() < expit(0.8) else 3 - better))
        rows.append(Answer(f"r{r}", ("gt0", "catch0"), 1))
    found = strengths(Answers(rows, videos, []), ["gt", "net"], 200, 0)
    low, high = found["net"].interval
    assert found["gt"].value == 0 and low < -0.8 < high < 0


def test_a_paired_study_is_analysed(tmp_path):
    key = made_key("paired")
    key.write(tmp_path)
    records = []
    for rater in range(12):
        record = record_of(key, rater % len(key.lists), rater)
        for answer in record["answers"]:
            truth = [key.videos[name].condition for name in answer["videos"]].index("Ground truth")
            answer["answer"] = 1 + truth
        records.append(record)
    write_records(tmp_path, records)
    assert run(config(f"export={tmp_path}", f"output={tmp_path / 'out'}")) == 0
    summary = json.loads((tmp_path / "out/analysis.json").read_text())
    # Never chosen before ground truth in 12 × 4 pairs; half a choice is added each way.
    n = sum(len(trials) - sum(map(key.is_catch, trials)) for trials in key.lists) * 2
    assert summary["strengths"]["generated"]["value"] == pytest.approx(np.log(0.5 / (n + 0.5)), abs=1e-3)
    assert summary["scores"] == [] and summary["raters"] == {"all": 12, "kept": 12}
    assert "Log strengths" in (tmp_path / "out/report.html").read_text()
    assert "generated & -" in (tmp_path / "out/table.tex").read_text()


def test_the_report_is_one_harmless_page(study, tmp_path, capsys):
    key, folder = study
    records = [judging(key, k % len(key.lists), k) for k in range(8)]
    records[0]["platform"] = {"PROLIFIC_PID": "-5", "STUDY_ID": "s", "SESSION_ID": "x"}
    records.append(record_of(key, 0, 99))
    write_records(folder, [*records, '{"<script>": 1}'])
    assert run(config(f"export={folder}", f"output={tmp_path / 'out'}")) == 1
    said = capsys.readouterr()
    assert "8 of 9 raters count, 1 are left out" in said.out and "error: answers.jsonl" in said.err
    page = (tmp_path / "out/report.html").read_text()
    assert "default-src 'none'" in page and not re.search(r"""(src|href)=["'](?!data:|#)""", page)
    assert "<script" not in page and "1 took catch trials for plausible" in page
    with (tmp_path / "out/ratings.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert rows[0]["PROLIFIC_PID"] == "'-5" and rows[0]["STUDY_ID"] == "s"  # no spreadsheet takes it for a formula
    assert {row["counts"] for row in rows if row["rater"] == f"{99:032x}"} == {"0"}
    summary = json.loads((tmp_path / "out/analysis.json").read_text())
    whole = next(s for s in summary["scores"] if (s["object"], s["condition"]) == (ALL, "generated"))
    assert whole["mean"]["low"] <= whole["mean"]["value"] == pytest.approx(4.5) and summary["raters"]["kept"] == 8
    assert r"all & 4.50 & " in (tmp_path / "out/table.tex").read_text()
    assert len(list(csv.reader((tmp_path / "out/scores.csv").open()))) == 1 + 2 * 3

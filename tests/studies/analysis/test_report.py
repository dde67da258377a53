"""
The Results section: oracle, the numbers of the analysis; files are read again by independent
readers.
"""

import io

import docx
import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest

import trustlab as tl

mpl.use("Agg")


def frame_of(synthetic=False):
    cells = pd.MultiIndex.from_product(
        [range(10), ["M", "TMIG"], ["easy", "hard_#1"]], names=["who", "scheme", "task"]
    )
    frame = cells.to_frame(index=False)
    rng = np.random.default_rng(0)
    frame = frame.assign(error=rng.standard_normal(40) + (frame["scheme"] == "M"))
    frame.attrs["synthetic"] = synthetic
    return frame


def one_way():
    frame = frame_of()[lambda f: f["task"] == "easy"]
    return tl.report(frame, dv="error", within="scheme", subject="who")


def two_way(**more):
    return tl.report(frame_of(**more), dv="error", within=["scheme", "task"], subject="who")


@pytest.mark.parametrize("make", [one_way, two_way])
def test_text_and_tables_are_those_of_the_analysis(make):
    found = make()
    assert found.text.startswith(found.result.apa())
    pd.testing.assert_frame_equal(found.table(), found.result.table())
    assert "Table 2" in found._repr_html_()
    assert found.plot() is not None


def test_html_is_read_again(tmp_path):
    path = two_way().write(tmp_path / "results.html")
    tables = pd.read_html(io.StringIO(path.read_text()))
    means = [f"{mean:.2f}".replace("-", "−") for mean in two_way().result.descriptives()["mean"]]
    assert tables[0]["M"].astype(str).tolist() == means
    assert tables[1]["effect"].tolist() == ["scheme", "task", "scheme × task"]
    assert "<svg" in path.read_text()


def test_word_is_read_again(tmp_path):
    found = two_way(synthetic=True)
    document = docx.Document(str(found.write(tmp_path / "results.docx")))
    assert document.paragraphs[0].text == found.text
    assert "synthetic data" in document.paragraphs[1].text
    assert document.tables[1].cell(1, 0).text == "scheme"
    assert len(document.inline_shapes) == 1


def test_latex_has_no_sign_that_it_would_misread(tmp_path):
    text = two_way().write(tmp_path / "results.tex").read_text()
    assert r"hard\_\#1" in text
    assert r"$\times$" in text
    assert text.count("\\begin{tabular}") == 4
    assert not set("−×²ηε") & set(text)


def test_another_ending_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"must be one of '\.html', '\.tex', '\.docx'"):
        one_way().write(tmp_path / "results.rtf")


def test_levels_that_are_numbers_stay_as_they_are(tmp_path):
    frame = frame_of().replace({"M": 0.0, "TMIG": 0.125}).infer_objects()
    found = tl.report(frame, dv="error", within=["scheme", "task"], subject="who").write(
        tmp_path / "results.html"
    )
    assert pd.read_html(io.StringIO(found.read_text()))[0]["scheme"].tolist() == [
        0.0,
        0.0,
        0.125,
        0.125,
    ]


@pytest.mark.parametrize("ending", ["html", "tex", "docx"])
@pytest.mark.parametrize("sign", ["\x00", "\x0b", "\x1f", "\x7f"])
def test_control_characters_are_refused_by_every_writer(tmp_path, ending, sign):
    table = pd.DataFrame({"mode": ["A", f"B{sign}"], "mean": [1.0, 2.0]})
    with pytest.raises(ValueError, match=r"holds a control character.*rename the level or column"):
        tl.report(table).write(tmp_path / f"a.{ending}")
    assert not list(tmp_path.iterdir())
    tl.report(table.replace(f"B{sign}", "B\tβ\n2")).write(tmp_path / f"a.{ending}")

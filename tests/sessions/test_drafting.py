"""Drafted recipes. Oracle: the values of the log, written out by hand."""

import gzip

import numpy as np
import pytest

import trustlab as tl


@pytest.fixture
def drafted(tmp_path):
    """A function that writes a log and drafts its recipe; it returns the draft and the session."""

    def draft(text, name="run.csv", **filled):
        log = tmp_path / name
        content = text if isinstance(text, bytes) else text.encode()
        log.write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
        recipe = tl.draft_recipe(log, tmp_path / f"{name}.toml")
        draft = recipe.read_text(encoding="utf-8")
        for line in filled.values():
            draft = draft.replace(*line)
        recipe.write_text(draft, encoding="utf-8")
        return draft, tl.read_session(log, recipe)

    return draft


LAB = """# rig 2, spring
Time [ms];Drive Mode;Cross Track Error [mm];pos x [m];pos y [m];note
0;manual;1,5;0,0;0,0;a
100;manual;1,6;0,0;0,1;b
200;robot;1,7;0,2;0,1;c
300;robot;1,8;0,3;0,1;d
"""


def test_a_draft_reads_a_log_of_another_style(drafted, tmp_path):
    draft, session = drafted(LAB)
    np.testing.assert_allclose(session.t, [0.0, 0.1, 0.2, 0.3], atol=1e-12)
    assert session["mode"].tolist() == [1.0, 1.0, 0.0, 0.0]
    np.testing.assert_allclose(session["path_error"], [1.5e-3, 1.6e-3, 1.7e-3, 1.8e-3])
    assert session["robot_x"].tolist() == [0.0, 0.0, 0.2, 0.3]
    assert session["robot_y"].tolist() == [0.0, 0.1, 0.1, 0.1]
    assert draft.endswith("#   note\n")
    with pytest.raises(tl.SessionError, match=r"run\.csv\.toml exists already"):
        tl.draft_recipe(tmp_path / "run.csv", tmp_path / "run.csv.toml")


SPACES = """  stamp_s   driver   err_cm
 0.0   human    10
 0.1   robot     9.5
 0.2   human    11
"""


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("run.txt", SPACES),
        ("run.csv.gz", "stamp_s,driver,err_cm\n0,human,10\n0.1,robot,9.5\n0.2,human,11\n"),
        ("run.tsv", "stamp_s\tdriver\terr_cm\n0\thuman\t10\n0.1\trobot\t9.5\n0.2\thuman\t11\n"),
        ("run.csv", "stamp_s|driver|err_cm\n0|human|10\n0.1|robot|9.5\n0.2|human|11\n"),
    ],
)
def test_every_text_that_a_recipe_reads_is_drafted(drafted, name, text):
    _, session = drafted(text, name)
    np.testing.assert_allclose(session.t, [0.0, 0.1, 0.2], atol=1e-15)
    assert session["mode"].tolist() == [1.0, 0.0, 1.0]
    np.testing.assert_allclose(session["path_error"], [0.1, 0.095, 0.11], atol=1e-15)


def test_what_a_draft_cannot_know_is_asked_for(tmp_path):
    log, recipe = tmp_path / "run.csv", tmp_path / "lab.toml"
    log.write_text("stamp,ctrl,heading\n10,A,0.1\n20,B,0.2\n30,A,0.3\n")
    tl.draft_recipe(log, recipe)
    for old, new, words in [
        ('unit = "?"', 'unit = "deg"', r"\[columns\] yaw: unknown unit '\?'"),
        ('"A" = "?"', '"A" = 1', r"\[columns\] mode: map entry 'A' must be a number, got '\?'"),
        ('"B" = "?"', '"B" = 0', r"\[columns\] mode: map entry 'B'"),
    ]:
        with pytest.raises(tl.sessions.RecipeError, match=words):
            tl.read_session(log, recipe)
        recipe.write_text(recipe.read_text().replace(old, new))
    assert tl.read_session(log, recipe)["mode"].tolist() == [1.0, 0.0, 1.0]


def test_who_drives_is_guessed_from_two_words_in_any_encoding(drafted):
    """Oracle: the same log in UTF-8."""
    text = "Zeit (ms);Fahrer;Güte (%)\n0;Mensch;1,5\n100;Übergabe;1,6\n200;Mensch;1,7\n"
    sessions = []
    for encoding in ("utf-8", "cp1252"):
        word = ('"Übergabe" = "?"', '"Übergabe" = 0')
        draft, session = drafted(text.encode(encoding), f"{encoding}.csv", word=word)
        assert ('encoding = "cp1252"' in draft) == (encoding == "cp1252")
        assert draft.endswith("#   Güte (%)\n")
        sessions.append(session)
    assert sessions[0].data.equals(sessions[1].data)
    assert sessions[1]["mode"].tolist() == [1.0, 0.0, 1.0]
    np.testing.assert_allclose(sessions[1].t, [0.0, 0.1, 0.2], atol=1e-12)


def test_what_a_draft_leaves_out_reading_asks_for(drafted, tmp_path):
    """Blank cells, signs and stamps that jitter, one after the other."""
    text = "stamp_ms,mode,cte_m\n0,1,.30\n103,1,-.31\n199,0,\n300,0,.33\n"
    grid = '\n[resampling]\nmethod = "linear"\nsample_time = 0.101\n'
    rule = 'unit = "m"'
    filled = {}
    for old, new, words in [
        (rule, rule + ', blank = "hold"', 'blank = "hold"'),
        (rule, rule + ", absolute = true", "absolute"),
        ("# performance_window", grid + "# ", r"\[resampling\]"),
    ]:
        with pytest.raises(tl.SessionError, match=words):
            drafted(text, **filled)
        (tmp_path / "run.csv.toml").unlink()
        filled[words] = (old, new)
    assert drafted(text, **filled)[1].sample_time == 0.101


@pytest.mark.parametrize(
    ("name", "content"), [("a.bag", b"x"), ("a.csv", b""), ("a.parquet", b"no")]
)
def test_files_that_are_no_tables(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(tl.SessionError, match=name):
        tl.draft_recipe(tmp_path / name, tmp_path / "lab.toml")
    assert not (tmp_path / "lab.toml").exists()

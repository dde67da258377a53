"""Drafted recipes. Oracle: the values written out by hand, read without any recipe."""

import numpy as np
import pytest

import trustlab as tl

LAB = """# rig 2, spring
Time [ms];Drive Mode;Cross Track Error [mm];pos x [m];pos y [m];note
0;manual;1,5;0,0;0,0;a
100;manual;-1,6;;0,1;b
200;robot;1,7;0,2;0,1;c
300;robot;1,8;0,3;0,1;d
"""


def test_a_draft_reads_a_log_of_another_style(tmp_path):
    log = tmp_path / "run.csv"
    log.write_text(LAB)
    recipe = tl.draft_recipe(log, tmp_path / "lab.toml")
    session = tl.read_session(log, recipe)
    np.testing.assert_allclose(session.t, [0.0, 0.1, 0.2, 0.3], atol=1e-12)
    assert session["mode"].tolist() == [1.0, 1.0, 0.0, 0.0]
    np.testing.assert_allclose(session["path_error"], [1.5e-3, 1.6e-3, 1.7e-3, 1.8e-3])
    assert session["robot_x"].tolist() == [0.0, 0.0, 0.2, 0.3]
    assert "note: a, b, c, d" in recipe.read_text()
    with pytest.raises(tl.SessionError, match=r"lab\.toml exists already"):
        tl.draft_recipe(log, recipe)


def test_what_a_draft_cannot_know_is_asked_for(tmp_path):
    log = tmp_path / "run.csv"
    log.write_text("stamp,ctrl,heading\n10,A,0.1\n20,B,0.2\n30,A,0.3\n")
    recipe = tl.draft_recipe(log, tmp_path / "lab.toml")
    with pytest.raises(tl.SessionError) as caught:
        tl.read_session(log, recipe)
    said = str(caught.value)
    lines = recipe.read_text().splitlines()
    for name in ("mode", "yaw"):
        number = next(k for k, line in enumerate(lines, 1) if line.startswith(f"{name} ="))
        assert f"line {number}: [columns] {name}: " in said


@pytest.mark.parametrize("suffix", ["parquet", "csv"])
def test_a_draft_of_our_own_file_changes_nothing(tmp_path, suffix):
    pilot = tl.read_session("data/sessions/pilot.csv")
    path = tmp_path / f"pilot.{suffix}"
    tl.write_session(pilot, path)
    read = tl.read_session(path, tl.draft_recipe(path, tmp_path / "lab.toml"))
    assert read.data.equals(pilot.data)


def test_files_that_are_no_tables_are_refused(tmp_path):
    for name, content in (("a.bag", b"#ROSBAG V2.0"), ("a.csv", b""), ("a.parquet", b"no")):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(tl.SessionError, match=name):
            tl.draft_recipe(path, tmp_path / "lab.toml")


def test_who_drives_is_guessed_from_two_words_in_another_language(tmp_path):
    log = tmp_path / "fahrt.csv"
    log.write_text("Zeit (ms);Fahrer;Tempo\n0;Mensch;1,5\n100;Roboter;1,6\n200;Mensch;1,7\n")
    recipe = tl.draft_recipe(log, tmp_path / "lab.toml")
    assert "# p_r = " in recipe.read_text()
    session = tl.read_session(log, recipe)
    assert session["mode"].tolist() == [1.0, 0.0, 1.0]
    np.testing.assert_allclose(session.t, [0.0, 0.1, 0.2], atol=1e-12)


def test_text_that_windows_wrote_is_drafted_and_read(tmp_path):
    """Oracle: the same log in UTF-8."""
    text = "Zeit;Fahrer;Güte (%)\n0;Mensch;1,5\n0,1;Übergabe;1,6\n0,2;Mensch;1,7\n"
    modes = {"Mensch": 1, "Übergabe": 0}
    read = []
    for encoding in ("utf-8", "cp1252"):
        log = tmp_path / f"{encoding}.csv"
        log.write_text(text, encoding=encoding)
        recipe = tl.draft_recipe(log, tmp_path / f"{encoding}.toml")
        lines = recipe.read_text(encoding="utf-8").replace('"Übergabe" = "?"', '"Übergabe" = 0')
        assert ('encoding = "cp1252"' in lines) == (encoding == "cp1252")
        recipe.write_text(f'{lines}p_r = {{ column = "Güte (%)", unit = "%" }}\n', encoding="utf-8")
        read.append(tl.read_session(log, recipe))
    assert read[0].data.equals(read[1].data)
    assert read[1]["mode"].tolist() == [modes[word] for word in ("Mensch", "Übergabe", "Mensch")]
    with pytest.raises(tl.SessionError, match=r'line 1: byte 0xfc .*encoding = "cp1252"'):
        tl.read_session(log, tmp_path / "utf-8.toml")
    log.write_text(text.replace("1,7", "1,x"), encoding="cp1252")  # row by row, to name the line
    with pytest.raises(tl.SessionError, match=r"line 4, column 'Güte \(%\)'"):
        tl.read_session(log, tmp_path / "cp1252.toml")


def test_stamps_that_jitter_are_drafted_with_an_even_grid(tmp_path):
    log = tmp_path / "run.csv"
    log.write_text("stamp_ms,mode,p_r\n0,1,.30\n103,1,.31\n199,0,.32\n300,0,.33\n")
    recipe = tl.draft_recipe(log, tmp_path / "lab.toml")
    session = tl.read_session(log, recipe)
    np.testing.assert_allclose(np.diff(session.t), float(f"{np.median([103, 96, 101]):g}") / 1e3)


def test_performance_is_known_by_its_name_and_unit(tmp_path):
    log = tmp_path / "run.csv"
    log.write_text(
        "t_ms,driver,robot_perf_pct,operator_performance [%]\n"
        + "".join(f"{100 * k},{'op' if k < 5 else 'auto'},{40 + k},61.5\n" for k in range(10))
    )
    recipe = tl.draft_recipe(log, tmp_path / "lab.toml")
    session = tl.read_session(log, recipe)
    assert session.columns == ["mode", "p_r", "p_h"]
    np.testing.assert_allclose(session.data["p_r"], 0.4 + 0.01 * np.arange(10))
    np.testing.assert_allclose(session.data["p_h"], 0.615)

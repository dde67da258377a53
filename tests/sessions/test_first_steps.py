"""
What somebody meets who reads a log of their own for the first time: each error names the step that
comes next.
"""

import numpy as np
import pandas as pd
import pytest

import trustlab as tl

ROW = "0.50,-0.14,0.44,0.0,2023-09-12_10-49-07\n"


def test_a_file_without_names_that_holds_a_date(tmp_path):
    path = tmp_path / "trial.csv"
    path.write_text(3 * ROW)
    with pytest.raises(
        tl.SessionError, match=r"found numbers instead of column names; .*header = false"
    ):
        tl.read_session(path)


def test_a_recipe_that_counts_columns_of_a_file_with_names(tmp_path):
    recipe = tmp_path / "mine.toml"
    recipe.write_text(
        'name = "mine"\nkind = "table"\n[time]\ncolumn = 3\nunit = "s"\n[columns]\np_r = '
        "{column = 0}\n"
    )
    with pytest.raises(tl.SessionError, match=r"add the lines \[table\] and header = false"):
        tl.read_session(tmp_path / "trial.csv", recipe=recipe)


def test_a_command_that_is_a_position(tmp_path):
    recipe = tmp_path / "mine.toml"
    recipe.write_text(
        'name = "mine"\nkind = "table"\n[time]\ncolumn = "t"\nunit = "s"\n[columns]\nu_h_y = '
        '{column = "y", unit = "m"}\n'
    )
    with pytest.raises(tl.SessionError, match="leave the unit out"):
        tl.sessions.load_recipe(recipe)


def test_performance_that_nobody_computed():
    session = tl.Session(
        pd.DataFrame({"t": [0.0, 0.1], "mode": [1.0, 0.0]}), tl.Metadata(condition=0.4)
    )
    with pytest.raises(
        tl.SessionError, match=r"condition 0\.4 has no column 'p_h'.*with_performance"
    ):
        tl.fit_robot(session)
    with pytest.raises(tl.SessionError) as caught:
        session.with_performance()
    assert "mixed_initiative" in str(caught.value)


def test_commanded_positions_are_named_where_commands_are_missing():
    """A device whose position is the command, as in the public study that has a recipe."""
    t = 0.1 * np.arange(4)
    moved = {
        f"{who}_{axis}": 0.01 * np.arange(4.0)
        for who in ("human", "reference", "robot")
        for axis in "yz"
    }
    session = tl.Session(pd.DataFrame({"mode": 0.6, **moved}, index=pd.Index(t, name="t")))
    scales = {
        "measure": "mixed_initiative",
        "e_max": 0.1,
        "u_max": 0.1,
        "axes": "yz",
        "window": 0.2,
    }
    with pytest.raises(
        tl.SessionError, match=r"no column 'u_h_y'.*with_columns\(u_h_x=session\['human_x'\], …\)"
    ):
        session.with_performance(**scales)
    commands = {"h": "human", "i": "reference", "a": "reference"}
    given = {
        f"u_{who}_{axis}": session[f"{name}_{axis}"]
        for who, name in commands.items()
        for axis in "yz"
    }
    measured = session.with_columns(**given).with_performance(**scales)
    assert measured["p_r"].tolist() == measured["p_h"].tolist() == [1.0] * 4

"""Folders of logs: which files, in which order, with which header. Oracle: the files laid out."""

import pytest

from tests.sessions.logs import table_recipe
from trustlab.sessions import SessionError, read_session, read_sessions
from trustlab.sessions.folders import logs_in

TABLE = "t,a\n0,0.5\n1,0.5\n"
COLUMNS = '[columns]\np_r = { column = "a" }\n'
INDEXED = f"""[files]
pattern = "p{{who:int}}/run{{trial:int}}.csv"
[header]
file = "p{{who}}/runs.csv"
keys = {{ trial = "run" }}
{COLUMNS}r = {{ from = "header.share", unit = "%" }}
beta = {{ from = "header.level", map = {{ low = 0.1, high = 0.9 }} }}
[metadata]
participant = {{ from = "who" }}
trial = {{ from = "trial" }}
"""
HEADER = "run, share,level\n1,10,low\n2,20,low\n10,30,high\n"


def lay(folder, people=(9, 10), runs=(1, 2, 10)):
    for who in people:
        (folder / f"p{who}").mkdir(parents=True)
        (folder / f"p{who}" / "runs.csv").write_text(HEADER)
        for run in runs:
            (folder / f"p{who}" / f"run{run}.csv").write_text(TABLE)
    return folder


def runs(sessions):
    return [(each.metadata.participant, each.metadata.more["trial"]) for each in sessions]


@pytest.mark.parametrize("below", [".", "study"])
def test_files_are_found_at_any_depth_and_ordered_by_number(tmp_path, monkeypatch, below):
    lay(tmp_path / "study" / "raw")
    recipe = table_recipe(INDEXED)
    sessions = read_sessions(tmp_path / below, recipe)
    assert runs(sessions) == [(who, run) for who in (9, 10) for run in (1, 2, 10)]
    assert [each["r"][0] for each in sessions] == pytest.approx([0.1, 0.2, 0.3] * 2)
    assert [each["beta"][0] for each in sessions] == [0.1, 0.1, 0.9] * 2
    monkeypatch.chdir(tmp_path / "study" / "raw" / "p9")
    assert runs(read_sessions(".", recipe)) == [(9, 1), (9, 2), (9, 10)]
    assert read_session("run10.csv", recipe).metadata.more["trial"] == 10


def test_a_header_above_the_folder_names_other_sessions_too(tmp_path):
    lay(tmp_path / "raw")
    rows = [f"{who},{run},10,low\n" for who in (9, 10) for run in (1, 2, 10)]
    (tmp_path / "raw" / "index.csv").write_text("who,run,share,level\n" + "".join(rows))
    text = INDEXED.replace("p{who}/runs.csv", "index.csv").replace(
        "keys = {", 'keys = { who = "who",'
    )
    assert len(read_sessions(tmp_path / "raw", table_recipe(text))) == 6
    assert len(read_sessions(tmp_path / "raw" / "p9", table_recipe(text))) == 3


@pytest.mark.parametrize(
    ("header", "words"),
    [
        (HEADER + "11,10,low\n", r"runs\.csv: names run 11, which has no file"),
        (HEADER.replace("run,", "rum,"), r"runs\.csv: needs one column 'run'; did you mean 'rum'"),
        (HEADER.replace("1,10,low", "1,,low"), r"run1\.csv.*no header\.share, or it is empty"),
        (None, r"runs\.csv: this header file cannot be read"),
    ],
)
def test_headers_and_files_correspond(tmp_path, header, words):
    path = lay(tmp_path, people=(9,)) / "p9" / "runs.csv"
    path.unlink()
    if header is not None:
        path.write_text(header)
    with pytest.raises(SessionError, match=words):
        read_sessions(tmp_path, table_recipe(INDEXED))


def test_a_pattern_that_nothing_fits_names_what_is_there(tmp_path):
    (tmp_path / "vpA.csv").write_text(TABLE)
    recipe = table_recipe(f'[files]\npattern = "vp{{participant:int}}.csv"\n{COLUMNS}')
    with pytest.raises(SessionError, match=r"pattern '[^']*' \(there are .*vpA\.csv"):
        read_sessions(tmp_path, recipe)


def test_faults_are_raised_or_collected(tmp_path):
    for k in (10, 2, 1):
        (tmp_path / f"p{k}.csv").write_text("t,p_r\n0,1\n1,x\n" if k == 2 else "t,p_r\n0,1\n1,2\n")
    (tmp_path / "notes.txt").write_text("not a log")
    sessions = read_sessions(tmp_path, on_error="collect")
    assert [each.metadata.source for each in sessions] == [
        f"{tmp_path}/p1.csv",
        f"{tmp_path}/p10.csv",
    ]
    assert sessions.faults["file"].tolist() == [str(tmp_path / "p2.csv")]
    assert "line 3, column 'p_r': 'x' is not" in sessions.faults["error"][0]
    with pytest.raises(SessionError, match=r"p2\.csv: line 3"):
        read_sessions(tmp_path)


def test_a_doubt_about_many_files_is_told_once(tmp_path, recwarn):
    for k in range(15):
        (tmp_path / f"p{k}.csv").write_text("t,p_r,p_h\n0,50,60\n1,70,80\n")
    assert len(read_sessions(tmp_path)) == 15
    start = f"{tmp_path / 'p0.csv'} (and 14 more of the files): column "
    for each, name in zip(recwarn.list, ("p_r", "p_h"), strict=True):
        assert str(each.message).startswith(start + name)
        assert each.filename == __file__


@pytest.mark.filterwarnings("ignore:.*samples are 100 s apart")
def test_files_being_written_and_loops_are_no_sessions(tmp_path):
    (tmp_path / ".trustlab-host-1-x").mkdir()
    (tmp_path / ".trustlab-host-1-x" / "run1.csv").write_text(TABLE)
    (tmp_path / "run2.csv").write_text(TABLE)
    (tmp_path / "run3.csv.partial-1").write_text("t,a\n0,")
    (tmp_path / "loop").symlink_to(tmp_path, target_is_directory=True)
    (tmp_path / ".ipynb_checkpoints").mkdir()  # of JupyterLab, macOS and Excel
    (tmp_path / ".ipynb_checkpoints" / "run4.csv").write_text(TABLE)
    for name in ("._run5.csv", "~$run6.csv"):
        (tmp_path / name).write_bytes(b"\0")
    recipe = table_recipe(f'[files]\npattern = "*run{{k:int}}.csv*"\n{COLUMNS}')
    sources = [each.metadata.source for each in read_sessions(tmp_path, recipe)]
    assert sources == [str(tmp_path / "run2.csv")]
    assert logs_in(str(tmp_path)) == sources
    (tmp_path / "run4.csv").symlink_to(tmp_path / "run4.csv")
    with pytest.raises(SessionError, match=r"run4\.csv: there is no file at this path"):
        read_sessions(tmp_path, recipe)


@pytest.mark.parametrize("name", ["p9", "p11"])
def test_folders_that_are_links_are_read_and_no_folder_twice(tmp_path, name):
    """They were left out without a word."""
    (tmp_path / "study").mkdir()
    lay(tmp_path / "disk", people=(name[1:],), runs=(1, 2, 10))
    lay(tmp_path / "study", people=(10,), runs=(1, 2, 10))
    (tmp_path / "study" / name).symlink_to(tmp_path / "disk" / name)
    links = {"loop": tmp_path, "a latest": tmp_path / "study" / "p10", "up/loop": tmp_path / "disk"}
    (tmp_path / "study" / "up").mkdir()
    for link, target in links.items():
        (tmp_path / "study" / link).symlink_to(target)
    (tmp_path / "disk" / name / "loop").symlink_to(tmp_path / "disk")
    sessions = read_sessions(tmp_path / "study", table_recipe(INDEXED))
    assert runs(sessions) == [(who, k) for who in sorted([10, int(name[1:])]) for k in (1, 2, 10)]

"""
What a server must refuse, and what it must not lose; asked over sockets, without a browser. Oracle:
the files on the disk.
"""

import io
import json
import os
import re
import stat
import zipfile
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest

import trustlab as tl
from trustlab.live.study.store import read_tokens, tokens_path

WIDTH = 15
CONSENT = {"page": 0, "answers": {"consent": True}}


def rows(first, count):
    return [[k, 100.0 * k, 1, -1, *[0.01 * k] * (WIDTH - 2)] for k in range(first, first + count)]


def begun(client, url, tab="a"):
    """Consent, and begin the training drive."""
    client(f"{url}/answers", CONSENT)
    answer = client(f"{url}/begin", {"page": 1, "tab": tab})
    assert answer.status == 200
    return {"page": 1, "attempt": 0, "tab": tab}


def on_disk(plan, code="P01", name="01-training.0"):
    path = plan.folder / code / f"{name}.jsonl"
    return (
        [json.loads(line)[1] for line in path.read_text().splitlines()[1:]]
        if path.exists()
        else None
    )


def events(plan, code="P01"):
    path = plan.folder / code / "events.jsonl"
    return [json.loads(line)[1] for line in path.read_text().splitlines()] if path.exists() else []


# who may ask
# --------------------------------------------------------------------------------------------------


def test_foreign_hosts_are_misdirected(served, client):
    url = served.links["P01"]
    assert client(f"{url}/state").status == 200
    port = served.server.port
    for host in (
        "attacker.invalid",
        f"attacker.invalid:{port}",
        "127.0.0.1",
        f"127.0.0.1:{port + 1}",
        f"127.0.0.1.attacker.invalid:{port}",
    ):
        assert client(f"{url}/state", host=host).status in (400, 421), host
    assert client(f"{url}/state", host=f"localhost:{port}").status == 200


@pytest.mark.parametrize(
    "origin",
    [
        None,
        "null",
        "http://attacker.invalid",
        "https://127.0.0.1:{port}",
        "http://127.0.0.1",
        "http://127.0.0.1:{port}/",
    ],
)
def test_forged_origins_change_nothing(served, client, origin):
    origin = origin and origin.format(port=served.server.port)
    for link in (served.links["P01"] + "/answers", served.server.experimenter + "/act"):
        assert (
            client(link, {**CONSENT, "participant": "P01", "action": "end"}, Origin=origin).status
            == 403
        )
    assert events(served.plan) == []


def test_only_json_is_taken(served, client):
    for kind in ("text/plain", "application/x-www-form-urlencoded", "multipart/form-data", None):
        assert client(served.links["P01"] + "/answers", CONSENT, Content_Type=kind).status in (
            400,
            415,
        )
    for body in (
        b"",
        b"{",
        b"[]",
        b"3",
        b'{"page": NaN}',
        b"[" * 5000,
        b'{"page": 0, "answers": {"consent": true}',
    ):
        assert client(served.links["P01"] + "/answers", body).status == 400
    assert events(served.plan) == []


def test_wrong_tokens_lead_nowhere(served, client):
    base, token = served.base, read_tokens(served.plan.folder)["P01"]
    experimenter = read_tokens(served.plan.folder)["experimenter"]
    last = "A" if token[-1] != "A" else "B"
    for wrong in (
        "x" * 22,
        token[:-1] + last,
        token.swapcase(),
        token[:-1],
        token + "x",
        experimenter,
        "P01",
        "",
    ):
        assert client(f"{base}/p/{wrong}").status == 404
        assert client(f"{base}/p/{wrong}/state").status == 404
        assert client(f"{base}/p/{wrong}/answers", CONSENT).status == 404
    for wrong in (token, "x" * 22):
        assert client(f"{base}/experimenter/{wrong}").status == 404
        assert client(f"{base}/experimenter/{wrong}/state").status == 404
        assert (
            client(
                f"{base}/experimenter/{wrong}/act", {"participant": "P01", "action": "end"}
            ).status
            == 404
        )
    assert events(served.plan) == []


def test_who_opens_a_wrong_link_is_told_in_words_what_to_do(served, client):
    """
    A page for browsers, the same for every wrong link, with the headers of all; scripts get the
    number.
    """
    opened = {"Accept": "text/html,application/xhtml+xml,*/*;q=0.8"}
    token = read_tokens(served.plan.folder)["P01"]
    wrong = [f"/p/{token[:-1]}", f"/p/{'x' * 22}", f"/experimenter/{token}", "/p/", "/"]
    answers = [client(f"{served.base}{path}", **opened) for path in wrong]
    assert {answer.status for answer in answers} == {404}
    assert len({answer.content for answer in answers}) == 1
    words = answers[0].content.decode()
    assert "ask the person who runs the study for your link" in words
    assert not any(secret in words for secret in (token, "P01", "trustlab", "tornado"))
    assert answers[0].headers["Content-Type"] == "text/html; charset=utf-8"
    assert answers[0].headers["Content-Security-Policy"].startswith("default-src 'none'")
    assert client(f"{served.base}/p/{'x' * 22}/state", Accept="*/*").json == {"error": 404}
    assert client(f"{served.base}/p/{token}", **opened).status == 200


def test_the_number_of_pages_leaves_out_the_end(served, client):
    """As `pages` of the table of participants: pages that somebody has to do."""
    pages = len(served.plan.steps("P01")) - 1
    assert client(f"{served.links['P01']}/state").json["pages"] == pages
    assert served.server.overview()["people"][0]["pages"] == pages
    assert tl.read_live_study(served.plan.folder).participants["pages"].tolist() == [pages] * 3


def test_paths_lead_to_no_other_file(served, client):
    token = read_tokens(served.plan.folder)["P01"]
    assert client(f"{served.base}/static/rows.js").status == 200
    tricks = [
        "/static/../study/plan.py",
        "/static/..%2fstudy%2fplan.py",
        "/static/%2e%2e/study/plan.py",
        "/static//etc/passwd",
        "/static/....//study.json",
        "/../../etc/passwd",
        "/mystudy/study.json",
        "/study.json",
        "/static/study.json",
        "//etc/passwd",
        f"/p/{token}/../../static/study.js",
        f"/p/{token}/events.jsonl",
        f"/p/{token}/rows/..",
        f"/p/{token}/__class__",
        f"/p/{token}/experimenter_end",
        "/static/",
        "/static/rows.js%00.html",
        "/",
        "/p/",
        "/static/rows.js/..",
    ]
    for path in tricks:
        for body in (None, {}):
            answer = client(served.base, body, path=path)
            assert answer.status in (400, 404, 405), (path, answer.status)
            assert token.encode() not in answer.content


def test_methods_that_have_no_meaning(served, client):
    url = served.links["P01"]
    assert client(f"{url}/answers").status == 405
    assert client(f"{url}/state", {}).status == 405
    for method in ("PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"):
        assert client(f"{url}/state", method=method).status in (405, 501)


def test_answers_tell_browsers_to_run_and_fetch_nothing_else(served, client):
    for path in (
        served.links["P01"],
        f"{served.links['P01']}/state",
        f"{served.base}/static/rows.js",
        f"{served.base}/none",
    ):
        headers = client(path).headers
        policy = headers["Content-Security-Policy"]
        assert policy.startswith(
            "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self';"
        )
        assert "unsafe-inline" not in policy
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Referrer-Policy"] == "no-referrer"
        assert headers["Cache-Control"] == "no-store"
        assert "ornado" not in headers["Server"]
    static = [
        content.decode().replace('xmlns="http://www.w3.org/2000/svg"', "")
        for name, content in served.server.files.items()
        if not name.endswith(".wasm")
    ]
    assert not any(
        re.search(r"https?://|innerHTML|eval\(|document\.write|insertAdjacentHTML", words)
        for words in static
    )
    assert stat.S_IMODE(tokens_path(served.plan.folder).stat().st_mode) == 0o600


def test_the_participant_is_told_no_condition(served, client):
    url, said = served.links["P01"], b""
    begun(client, url)
    for path, body in (("", None), ("/state", None), ("/begin", {"page": 1, "tab": "b"})):
        said += client(url + path, body).content
    order = served.plan.orders["P01"]
    page = next(step.index for step in served.plan.steps("P01") if step.page.name == "drive")
    participation = served.server.participation("P01")
    for index in range(1, page):
        participation.participant.add("page", page=index, name="x")
    answer = client(f"{url}/begin", {"page": page, "tab": "c"})
    assert answer.json["config"]["columns"]
    said += client(f"{url}/state").content + answer.content
    assert not re.search(rb"\bC[1-5]\b", said)
    header = (served.plan.folder / "P01" / f"{page:02d}-drive.0.jsonl").read_text().splitlines()[0]
    assert json.loads(header)[1]["condition"] == order[0]  # the lab knows


# how much
# --------------------------------------------------------------------------------------------------


def test_an_answer_of_a_megabyte_is_refused(served, client):
    answer = client(
        served.links["P01"] + "/answers", {"page": 0, "answers": {"consent": "x" * 1_000_000}}
    )
    assert answer.status in (0, 400, 413)
    long = json.dumps(CONSENT | {"more": "x" * 100_000}).encode()
    assert (
        client(served.links["P01"] + "/answers", long).status == 200
    )  # what is not asked for is not kept
    assert len(json.dumps(events(served.plan))) < 300


def test_long_words_are_refused_with_the_item(served, client):
    client(served.links["P01"] + "/answers", CONSENT)
    participation = served.server.participation("P01")
    page = next(step for step in participation.steps if step.page.name == "satisfaction")
    for index in range(1, page.index):
        participation.participant.add("page", page=index, name="x")
    answers = {"satisfaction": 4, "comfort": 4, "control": 4, "remark": "x" * 1001}
    refused = client(served.links["P01"] + "/answers", {"page": page.index, "answers": answers})
    assert (refused.status, refused.json["error"]) == (400, "remark: this answer cannot be taken")
    fits = answers | {"remark": "<script>alert(1)</script>" * 40}
    assert (
        client(served.links["P01"] + "/answers", {"page": page.index, "answers": fits}).status
        == 200
    )


def test_one_link_cannot_flood_the_server(served, client):
    url = served.links["P01"] + "/state"
    with ThreadPoolExecutor(8) as pool:
        found = [answer.status for answer in pool.map(client, [url] * 160)]
    assert set(found) == {200, 429}
    assert client(served.links["P02"] + "/state").status == 200  # nobody else is kept waiting


def test_rows_that_are_none(served, client):
    url = served.links["P01"]
    own = begun(client, url)
    good = rows(0, 1)[0]
    bad = [
        good[:-1],
        [*good, 0.0],
        ["0", *good[1:]],
        [0.0, *good[1:]],
        [True, *good[1:]],
        [*good[:-1], None],
        [*good[:-1], "1"],
        {},
        3,
        [*good[:-1], [1.0]],
        [*good[:-1], 10**400],
    ]
    for row in bad:
        assert client(f"{url}/rows", own | {"rows": [row]}).status == 400, row
    for given in (None, {}, "rows", 3):
        assert client(f"{url}/rows", own | {"rows": given}).status == 400
    assert (
        client(
            f"{url}/rows", json.dumps(own | {"rows": [good]}).replace("0.0", "Infinity").encode()
        ).status
        == 400
    )
    assert on_disk(served.plan) == []


# what is kept
# --------------------------------------------------------------------------------------------------


def test_rows_are_on_the_disk_when_they_are_acknowledged(served, client, monkeypatch):
    url = served.links["P01"]
    own = begun(client, url)
    synced, fsync = [], os.fsync

    def note(handle):
        fsync(handle)
        synced.append(os.fstat(handle).st_size)

    monkeypatch.setattr(os, "fsync", note)
    for first in (0, 5, 10):
        answer = client(f"{url}/rows", own | {"rows": rows(first, 5)})
        assert answer.json == {"have": first + 5, "current": True}
        path = served.plan.folder / "P01" / "01-training.0.jsonl"
        assert synced[-1] == path.stat().st_size
    assert (
        client(f"{url}/rows", own | {"rows": rows(3, 20)}).json["have"] == 23
    )  # sent again with more
    assert client(f"{url}/rows", own | {"rows": rows(40, 5)}).json["have"] == 23
    assert on_disk(served.plan) == rows(0, 23)


def test_a_disk_that_is_full_acknowledges_nothing(served, client, monkeypatch, caplog):
    url = served.links["P01"]
    own = begun(client, url)

    def full(handle):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        assert client(f"{url}/rows", own | {"rows": rows(0, 5)}).status == 507
        assert client(f"{url}/rows", own | {"rows": rows(0, 5)}).status == 507
        seen = client(f"{served.server.experimenter}/state").json
    assert "Nothing can be saved (No space left on device)" in seen["trouble"]
    assert caplog.text.count("No space left") == 1, "one line however often it is tried"
    assert "Traceback" not in caplog.text
    assert (
        read_tokens(served.plan.folder)["P01"] not in caplog.text
    )  # the log is no place for links
    assert client(f"{url}/rows", own | {"rows": rows(0, 5)}).json["have"] == 5
    assert on_disk(served.plan) == rows(0, 5)
    assert client(f"{served.server.experimenter}/state").json["trouble"] == ""
    assert "is saved again" in caplog.text


def test_the_window_that_began_last_drives(served, client):
    url = served.links["P01"]
    first = begun(client, url, "first")
    assert client(f"{url}/rows", first | {"rows": rows(0, 5)}).status == 200
    again = client(f"{url}/begin", {"page": 1, "tab": "second"})
    assert again.json["rows"] == [
        row[2:] for row in rows(0, 5)
    ]  # it goes on where the first one was
    refused = client(f"{url}/rows", first | {"rows": rows(5, 5)})
    assert (refused.status, refused.json["error"]) == (409, "another window drives")
    assert client(f"{url}/done", first | {"rows": 5}).status == 409
    assert client(f"{url}/rows", first | {"tab": "second", "rows": rows(5, 5)}).json["have"] == 10
    assert on_disk(served.plan) == rows(0, 10)


def test_a_second_click_and_a_second_window_find_the_page_done(served, client):
    url = served.links["P01"]
    with ThreadPoolExecutor(8) as pool:
        found = [
            answer.status
            for answer in pool.map(lambda _: client(f"{url}/answers", CONSENT), range(8))
        ]
    assert sorted(found) == [200, *[409] * 7]
    assert [event["kind"] for event in events(served.plan)] == ["page"]
    assert client(f"{url}/answers", CONSENT).json["page"] == 1
    for page in (-1, 1.0, "0", None, True, 10**30):
        assert client(f"{url}/answers", CONSENT | {"page": page}).status in (400, 409)


def test_a_drive_is_done_when_its_rows_are_here(served, client):
    url = served.links["P01"]
    own = begun(client, url)
    client(f"{url}/rows", own | {"rows": rows(0, 5)})
    missing = client(f"{url}/done", own | {"rows": 7})
    assert (missing.status, missing.json["have"]) == (409, 5)
    assert [event["kind"] for event in events(served.plan)] == ["page", "begin"]


# the experimenter
# --------------------------------------------------------------------------------------------------


def test_the_experimenter_restarts_a_drive_and_the_old_one_is_kept(served, client):
    url, act = served.links["P01"], served.server.experimenter + "/act"
    own = begun(client, url)
    client(f"{url}/rows", own | {"rows": rows(0, 5)})
    assert (
        client(act, {"participant": "P01", "action": "restart", "page": 0}).status == 400
    )  # no drive
    assert (
        client(act, {"participant": "P01", "action": "restart", "page": 2}).status == 400
    )  # not begun
    assert client(act, {"participant": "P01", "action": "restart", "page": 1}).status == 200
    late = client(f"{url}/rows", own | {"rows": rows(5, 5)})
    assert late.json == {"have": 10, "current": False}  # kept, and told to stop
    again = client(f"{url}/begin", {"page": 1, "tab": "a"})
    assert (again.json["attempt"], again.json["rows"]) == (1, [])
    assert on_disk(served.plan) == rows(0, 10)
    assert on_disk(served.plan, name="01-training.1") == []
    first, second = (
        served.server.participation("P01").participant.header(f"01-training.{k}")["config"]
        for k in (0, 1)
    )
    assert first != second  # another seed


def test_the_experimenter_sees_adds_and_ends(served, client):
    experimenter = served.server.experimenter
    own = begun(client, served.links["P01"])
    client(
        served.links["P01"] + "/rows",
        own | {"rows": rows(0, 5), "telemetry": {"fps": 60, "x": "no", "y": None}},
    )
    note = {"participant": "P01", "action": "note", "text": "<script>alert(1)</script> spoke"}
    seen = {person["code"]: person for person in client(f"{experimenter}/act", note).json["people"]}
    assert seen["P01"]["rows"] == 5
    assert seen["P01"]["telemetry"] == {"fps": 60.0}
    assert [one["text"] for one in seen["P01"]["notes"]] == [note["text"]]
    assert seen["P02"]["seconds_ago"] is None
    for body in (
        {"participant": "P09", "action": "end"},
        {"participant": "P01", "action": "overview"},
        {},
        {"participant": [], "action": "end"},
    ):
        assert client(f"{experimenter}/act", body).status == 400
    assert (
        client(
            f"{experimenter}/act", {"participant": "P01", "action": "note", "text": "x" * 1001}
        ).status
        == 400
    )
    assert client(f"{experimenter}/act", {"participant": "P01", "action": "end"}).status == 200
    assert client(served.links["P01"] + "/state").json["kind"] == "end"
    table = tl.read_live_study(served.plan.folder).participants.set_index("participant")
    assert table.loc["P01", "ended"]
    assert table.loc["P01", "notes"] == note["text"]


def test_people_decline_and_withdraw(served, client):
    decliner, leaver = served.links["P01"], served.links["P02"]
    assert client(f"{decliner}/withdraw", {}).json["title"] == "You have stopped"
    own = begun(client, leaver)
    client(f"{leaver}/rows", own | {"rows": rows(0, 5)})
    client(f"{leaver}/withdraw", {})
    client(f"{leaver}/withdraw", {})
    assert client(f"{leaver}/rows", own | {"rows": rows(5, 5)}).json["current"] is False
    assert client(f"{leaver}/state").json["kind"] == "end"
    ends = [event for event in events(served.plan, "P02") if event["kind"] == "end"]
    assert [event["source"] for event in ends] == ["participant"]
    table = tl.read_live_study(served.plan.folder).participants.set_index("participant")
    assert table["withdrawn"].to_dict() == {"P01": True, "P02": True, "P03": False}
    seen = client(served.server.experimenter + "/state").json["people"]
    assert [person["withdrawn"] for person in seen] == [True, True, False]


def test_the_length_of_the_study_is_told_beforehand(served, client):
    """10 s, 40 s and two laps of 87 s at full speed, and two sets of questionnaires."""
    minutes = client(served.links["P01"] + "/state").json["minutes"]
    drives = (10 + 40 + 2 * 1.5 * 87) / 60
    forms = 14 * 0.5 + (1 + 2 * 22) * 0.1
    assert minutes % 5 == 0
    assert drives + forms - 2 < minutes < drives + forms + 5


def test_everything_is_exported_as_a_zip_with_a_dictionary(served, client):
    url = served.links["P01"]
    begun(client, url)
    answer = client(served.server.experimenter + "/export")
    assert (answer.status, answer.headers["Content-Type"]) == (200, "application/zip")
    archive = zipfile.ZipFile(io.BytesIO(answer.content))
    package = json.loads(archive.read("datapackage.json"))
    names = [resource["name"] for resource in package["resources"]]
    assert names == [
        "participants",
        "answers",
        "measures",
        "samples",
        "items",
        "exclusions",
        "faults",
    ]
    assert {f"{name}.{kind}" for name in names for kind in ("csv", "parquet")} < set(
        archive.namelist()
    )
    people = pd.read_parquet(io.BytesIO(archive.read("participants.parquet")))
    assert people["pages_done"].tolist() == [1, 0, 0]
    assert client(url + "/export").status == 404
    assert client(f"{served.base}/experimenter/{'x' * 22}/export").status == 404


def test_who_is_deleted_while_the_study_is_served_is_gone(served, client):
    url = served.links["P01"]
    own = begun(client, url)
    client(f"{url}/rows", own | {"rows": rows(0, 5)})
    served.plan.delete("P01")
    for path, body in (
        ("", None),
        ("/state", None),
        ("/rows", own | {"rows": rows(5, 5)}),
        ("/begin", {"page": 1, "tab": "b"}),
    ):
        assert client(url + path, body).status == 404
    assert not (served.plan.folder / "P01").exists()
    seen = client(served.server.experimenter + "/state").json
    assert (seen["deleted"], [person["code"] for person in seen["people"]]) == (1, ["P02", "P03"])
    study = tl.read_live_study(served.plan.folder)
    assert study.deleted == ("P01",)
    assert "1 deleted" in study.summary()


def test_nothing_about_a_person_is_kept_but_what_the_documentation_lists(served, client):
    """
    Names of everything that an event or a row's file may hold; a new one belongs into the
    documentation first.
    """
    url = served.links["P01"]
    own = begun(client, url)
    client(
        f"{url}/rows",
        own | {"rows": rows(0, 5)},
        User_Agent="Mozilla/5.0 (secret)",
        Cookie="a=b",
        X_Forwarded_For="10.1.2.3",
    )
    client(f"{url}/note", own | {"row": 3, "text": "paused"})
    kept = {key for event in events(served.plan) for key in event}
    assert kept == {
        "at",
        "kind",
        "page",
        "name",
        "answers",
        "condition",
        "position",
        "attempt",
        "tab",
        "rows",
        "source",
        "row",
        "text",
        "link",
    }
    words = "".join(path.read_text() for path in served.plan.folder.rglob("*") if path.is_file())
    assert not re.search(r"Mozilla|secret|10\.1\.2\.3|127\.0\.0\.1", words)
    assert np.isfinite([event["at"] for event in events(served.plan)]).all()

"""
What a server must refuse, and what it must not lose; asked over sockets, without a browser. Oracle:
the files on the disk.
"""

import gc
import json
import os
import re
import resource
import socket
import stat
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import numpy as np
import pytest

import trustlab as tl
from tests.live.cases import advance, entries, events, record
from trustlab.live.study.plan import read_tokens, tokens_path
from trustlab.live.study.server import StudyServer

CONSENT = {"page": 0, "answers": {"consent": True}}
END = {"participant": "P01", "action": "end"}


# who may ask
# --------------------------------------------------------------------------------------------------


def test_foreign_hosts_are_misdirected(served, client):
    state, port = served.links["P01"] + "/state", served.server.port
    near = [f"127.0.0.1:{port + 1}", f"127.0.0.1.attacker.invalid:{port}"]
    for host in ("attacker.invalid", f"attacker.invalid:{port}", "127.0.0.1", *near):
        assert client(state, host=host).status in (400, 421), host
    for host in (None, f"localhost:{port}"):
        assert client(state, host=host).status == 200


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
        assert client(link, CONSENT | END, Origin=origin).status == 403
    assert events(served.plan) == []


def test_wrong_tokens_lead_nowhere(served, client):
    tokens = read_tokens(served.plan.folder)
    token, experimenter = tokens["P01"], tokens[".experimenter"]
    last = "A" if token[-1] != "A" else "B"
    near = [token[:-1] + last, token.swapcase(), token[:-1], token + "x"]
    wrong = [f"p/{each}" for each in ("x" * 22, *near, experimenter, "P01", "")]
    wrong += [f"experimenter/{each}" for each in (token, "x" * 22)]
    for place in wrong:
        link = f"{served.base}/{place}"
        statuses = [client(link + path).status for path in ("", "/state", "/export")]
        statuses += [client(f"{link}/{post}", CONSENT | END).status for post in ("answers", "act")]
        assert set(statuses) == {404}, place
    assert events(served.plan) == []


def test_paths_lead_to_no_other_file(served, client):
    token = read_tokens(served.plan.folder)["P01"]
    assert client(f"{served.base}/static/page.js").status == 200
    tricks = [
        "/static/../study/plan.py",
        "/static/%2e%2e/study/plan.py",
        "/static//etc/passwd",
        "/mystudy/study.json",
        f"/p/{token}/../../static/study.js",
        f"/p/{token}/events.jsonl",
        f"/p/{token}/__class__",
        f"/p/{token}/experimenter_end",
        "/static/",
        "/static/page.js%00.html",
        "/",
    ]
    for path in tricks:
        for body in (None, {}):
            answer = client(served.base, body, path=path)
            assert answer.status in (400, 404, 405), (path, answer.status)
            assert token.encode() not in answer.content


def test_answers_tell_browsers_to_run_and_fetch_nothing_else(served, client):
    for path in (
        served.links["P01"],
        f"{served.links['P01']}/state",
        f"{served.base}/static/page.js",
        f"{served.base}/none",
    ):
        headers = client(path).headers
        policy = headers["Content-Security-Policy"]
        assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self';")
        assert "unsafe-inline" not in policy
        assert headers["X-Content-Type-Options"] == "nosniff"
        assert headers["Referrer-Policy"] == "no-referrer"
        assert headers["Cache-Control"] == "no-store"
        assert "ornado" not in headers["Server"]
    static = [
        content.decode().replace('xmlns="http://www.w3.org/2000/svg"', "")
        for content in served.server.files.values()
    ]
    assert not any(
        re.search(r"https?://|innerHTML|eval\(|document\.write|insertAdjacentHTML", words)
        for words in static
    )
    assert stat.S_IMODE(tokens_path(served.plan.folder).stat().st_mode) == 0o600


def test_the_participant_is_told_no_condition(served, client, page, driving_page):
    url, said = served.links["P01"], b""
    for path in ("", "/state"):
        said += client(url + path).content
    participant = served.server.participant("P01")
    number = advance(participant, "drive")
    participant.add(
        "model", page=2, attempt=0, source="", why="", **served.plan.content["stand_in"]
    )
    answer = driving_page(url, number).begin()
    assert answer["config"]["columns"]
    said += served.state().content + json.dumps(answer).encode()
    said += json.dumps(page.drive(0, 5)).encode()
    assert not re.search(rb"\bC[1-5]\b", said)
    drive = record(served.plan, name=f"{number:02d}-drive")
    assert drive.header["condition"] == served.plan.orders["P01"][0]  # the lab knows


def test_foreign_pages_cannot_drive(served, driving_page):
    import websocket

    served.consent()
    for options in ({"origin": "http://attacker.invalid"}, {"host": "attacker.invalid"}):
        with pytest.raises(websocket.WebSocketBadStatusException, match=r"403|421"):
            driving_page(served.links["P01"], **options)
    for wrong in (served.base + "/p/" + "x" * 22, served.server.experimenter):
        with pytest.raises(websocket.WebSocketBadStatusException, match="404"):
            driving_page(wrong)
    assert [event["kind"] for event in events(served.plan)] == ["page"]


# how much
# --------------------------------------------------------------------------------------------------


def test_words_that_no_file_can_hold_are_refused(served, client):
    """Half of a pair of code units, as JSON lets it pass."""
    url = served.links["P01"]
    served.consent()
    page = advance(served.server.participant("P01"), "satisfaction")
    answers = '{"satisfaction": 4, "comfort": 4, "control": 4, "remark": "\\ud800 hi"}'
    body = f'{{"page": {page}, "answers": {answers}}}'.encode()
    refused = client(f"{url}/answers", body)
    assert (refused.status, refused.json["error"]) == (
        400,
        "Is there anything you would like to say about this drive? (You may leave this empty.)",
    )
    note = b'{"participant": "P01", "action": "note", "text": "\\ud800"}'
    assert client(f"{served.server.experimenter}/act", note).status == 400
    assert tl.read_live_study(served.plan.folder).export().exists()


def test_connections_are_capped_and_slow_heads_time_out(make_plan, serving, monkeypatch):
    monkeypatch.setattr("trustlab.live.study.server.HEADER_TIME", 2.0)
    with serving(make_plan()) as served:
        place = ("127.0.0.1", served.server.port)
        held = [socket.create_connection(place, timeout=30) for _ in range(150)]
        closed = 0
        for each in held[-20:]:
            each.settimeout(2.0)
            with suppress(TimeoutError, ConnectionError):
                closed += each.recv(1) == b""
        assert closed == 20, "beyond a hundred of an address"
        for each in held[50:]:
            each.close()
        began = time.monotonic()
        for each in held[:50]:
            each.sendall(b"GET /")
        assert held[0].recv(100) == b""
        assert 0.5 < time.monotonic() - began < 15.0
        assert served.state().status == 200
        for each in held[:50]:
            each.close()


def test_many_participants_may_have_more_files_than_a_process_usually_has(make_plan, serving):
    plan = make_plan(participants=60)
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    used = len(os.listdir("/proc/self/fd"))
    resource.setrlimit(resource.RLIMIT_NOFILE, (used + 20, hard))
    try:
        with serving(plan) as served:
            assert served.state("P60").status == 200
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_at_the_usual_port_browsers_leave_it_out(make_plan):
    server = StudyServer(make_plan(), 80)
    assert {"127.0.0.1", "localhost", "127.0.0.1:80"} <= server.hosts


# what is kept
# --------------------------------------------------------------------------------------------------


def test_a_disk_that_is_full_acknowledges_nothing(served, page, full_disk, caplog):
    with full_disk():
        for _ in range(2):
            assert "cannot save at the moment" in page.drive(0, 5)["trouble"]
        trouble = served.overview()["trouble"]
    assert "Nothing can be saved (No space left on device)" in trouble
    assert caplog.text.count("No space left") == 1, "one line however often it is tried"
    assert "Traceback" not in caplog.text
    assert read_tokens(served.plan.folder)["P01"] not in caplog.text  # no place for links
    assert page.drive(0, 5)["k"] == 5
    assert len(record(served.plan).commands) == 5
    assert served.overview()["trouble"] == ""
    assert "is saved again" in caplog.text


def test_a_slow_disk_holds_up_its_own_log_only(served, page, driving_page, monkeypatch):
    served.consent("P02")
    other = driving_page(served.links["P02"])
    other.begin()
    slow, sync = served.server.participant("P01").trial.log.handle, os.fsync
    done = threading.Event()

    def synced(handle):
        if handle == slow:
            assert done.wait(60.0)
        sync(handle)

    monkeypatch.setattr(os, "fsync", synced)
    page.socket.send(json.dumps({"window": "a", "k": 0, "commands": [[0.3, 0.1, 1]], "seen": 0}))
    assert [other.drive(k, 1)["k"] for k in range(5)] == [1, 2, 3, 4, 5]
    done.set()
    assert json.loads(page.socket.recv())["k"] == 1


def test_a_second_click_and_a_second_window_find_the_page_done(served, client):
    url = served.links["P01"]
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda _: client(f"{url}/answers", CONSENT), range(8)))
    assert sorted(answer.status for answer in answers) == [200, *[409] * 7]
    assert [event["kind"] for event in events(served.plan)] == ["page"]
    assert served.state().json["page"] == 1
    for page in (-1, 1.0, "0", None, True, 10**30):
        assert client(f"{url}/answers", CONSENT | {"page": page}).status in (400, 409)


def test_a_failed_start_lets_the_study_go(make_plan):
    plan = make_plan()
    path = tokens_path(plan.folder)
    path.chmod(0o644)
    with pytest.raises(ValueError, match="can be read by others"), StudyServer(plan):
        pass
    path.chmod(0o600)
    with StudyServer(plan) as server:
        assert server.links()
        with pytest.raises(ValueError, match="is being served already"), StudyServer(plan):
            pass
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(ValueError, match=f"cannot be served on port {port}"):
            StudyServer(plan, port=port).__enter__()
    with StudyServer(plan) as server:
        assert server.links()


@pytest.mark.parametrize("lost", ["lines", "file", "folder"])
def test_events_that_were_lost_are_not_gone_on_behind(make_plan, serving, client, lost):
    """Else the last link would be written anew, and nobody could see that there had been more."""
    plan = make_plan()
    with serving(plan) as served:
        link = served.links["P01"]
        served.consent()
        served.withdraw()
    folder = plan.folder / "P01"
    events = folder / "events.jsonl"
    lines = events.read_text().splitlines(keepends=True)
    events.write_text(lines[0])
    if lost != "lines":
        events.unlink()
    if lost == "folder":
        folder.rmdir()
    with serving(plan) as served:
        others = served.links["P02"].rpartition("/")[0]
        answer = client(f"{others}/{link.rpartition('/')[2]}/state")
        assert (answer.status, "cannot go on here" in answer.json["error"]) == (409, True)
        assert served.state("P02").status == 200  # the others go on
        overview = served.overview()
        assert "events.jsonl: its last lines are missing; restore it" in overview["trouble"]
        assert [person["code"] for person in overview["people"]] == ["P02", "P03"]
    assert tl.read_live_study(plan.folder).faults()["participant"].tolist() == ["P01"]
    folder.mkdir(exist_ok=True)
    events.write_text("".join(lines))
    with StudyServer(plan) as server:
        assert server.links()


def test_enrolment_and_requests_at_once_break_no_log(make_plan, serving, client):
    plan = make_plan(participants=20)
    with serving(plan, enrol=True) as served:
        join = served.overview()["join"]

        def both(k):
            barrier.wait()
            return client(join, {}) if k % 2 else served.consent(f"P{1 + k // 2:02d}")

        barrier = threading.Barrier(40)
        with ThreadPoolExecutor(40) as pool:
            list(pool.map(both, range(40)))
    study = tl.read_live_study(plan.folder)
    assert study.faults().empty
    assert all(len(each.events) in (1, 2) for each in study.records.values())


def test_only_a_proxy_leads_people_here_from_other_machines(make_plan, client):
    plan = make_plan()
    with pytest.raises(ValueError, match="url must be like"):
        StudyServer(plan, url="https://lab.test/study")
    with StudyServer(plan, url="https://lab.test") as server:
        link = server.links()["P01"]
        assert link.startswith("https://lab.test/p/")
        here = link.replace("https://lab.test", f"http://127.0.0.1:{server.port}")
        assert client(f"{here}/state", host="lab.test").status == 200
        body = {"host": "lab.test", "Origin": "https://lab.test"}
        assert client(f"{here}/answers", CONSENT, **body).status == 200


@pytest.mark.parametrize("url", ["https://Lab.Test/", "https://lab.test:443"])
def test_addresses_are_those_that_browsers_send(make_plan, url):
    assert StudyServer(make_plan(), url=url).url == "https://lab.test"
    for wrong in ("ftp://lab.test", "https://me:pw@lab.test", "https://lab.test?x=1", 5):
        with pytest.raises(ValueError, match="url must be like https://study"):
            StudyServer(make_plan(), url=wrong)


def test_all_that_people_see_is_in_the_language_of_the_study(make_plan, serving, client):
    plan = make_plan(participants=2, language="de")
    with serving(plan, enrol=True) as served:
        served.consent("P01")
        (plan.folder / "P02" / "events.jsonl").write_text('["0", {}]\n')
        join = served.overview()["join"]
        page = client(join).content.decode()
        assert '<html lang="de">' in page
        assert "<title>Eine Studie</title>" in page
        assert "Studie öffnen" in page
        lost = client(f"{served.base}/p/{'x' * 22}", Accept="text/html").content.decode()
        assert lost.count("Dieser Link führt zu keiner Studie") == 2
        assert client(join, {}).status == 200
        assert client(join, {}).json["error"].startswith("Alle Plätze dieser Studie sind vergeben")
    with serving(plan) as served:
        link = served.links["P01"].replace(*(read_tokens(plan.folder)[c] for c in ("P01", "P02")))
        error = client(f"{link}/state").json["error"]
        assert error.startswith("Die Studie kann hier nicht weitergehen")


def test_a_page_that_is_left_while_it_is_answered_is_no_mistake(page, monkeypatch, caplog):
    sync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: (time.sleep(0.1), sync(handle)))
    for _ in range(5):
        page.socket.send(json.dumps({"window": "a", "note": "x"}))
    page.socket.sock.close()
    time.sleep(1.5)
    gc.collect()
    assert "WebSocketClosedError" not in caplog.text


# the experimenter
# --------------------------------------------------------------------------------------------------


def test_the_experimenter_restarts_a_drive_and_the_old_one_is_kept(served, page, driving_page):
    page.drive(0, 5)
    for number, status in ((0, 400), (2, 400), ([1], 400), (1, 200)):  # no drive, not begun, begun
        assert served.act("restart", page=number).status == status
    assert page.drive(5, 5) == {"done": True}
    again = driving_page(served.links["P01"])
    begun = again.begin()
    assert (begun["k"], begun["config"]["attempt"]) == (0, 1)
    first, second = record(served.plan), record(served.plan, name="01-training.2")
    assert (len(first.rows), len(second.commands)) == (5, 0)
    assert first.end == "the experimenter let it be driven again"
    assert first.settings["seed"] != second.settings["seed"]
    assert tl.read_live_study(served.plan.folder).faults().empty


@pytest.mark.parametrize("act", ["restart", "end"])
def test_what_cannot_be_noted_ends_no_drive(served, page, monkeypatch, act):
    """Else the drive would be over, and what there is of it would count as all."""
    page.drive(0, 5)
    participant = served.server.participant("P01")

    def full(entries):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(participant.log, "append", full)
        assert served.act(act, page=1).status == 507
    assert page.drive(5, 5)["k"] == 10
    assert record(served.plan).end == ""


def test_the_experimenter_sees_adds_and_ends(served, page):
    page.drive(0, 5)
    words = "<script>alert(1)</script> spoke"
    seen = {person["code"]: person for person in served.act("note", text=words).json["people"]}
    assert (seen["P01"]["rows"], seen["P01"]["delay"]) == (5, 0.0)
    assert [one["text"] for one in seen["P01"]["notes"]] == [words]
    assert seen["P02"]["seconds_ago"] is None
    long = served.act("note", text="x" * 1001)
    for answer in (long, served.act("end", participant=[]), served.act("overview")):
        assert answer.status == 400
    assert long.json["error"].startswith("note: the answer must be 1 to 1000 characters")
    assert served.act("end").status == 200
    assert served.state().json["kind"] == "end"
    table = tl.read_live_study(served.plan.folder).participants.set_index("participant")
    assert table.loc["P01", "ended"]
    assert table.loc["P01", "notes"] == words


def test_people_decline_and_withdraw(served, page):
    assert served.withdraw("P02").json["title"] == "You have stopped"
    page.drive(0, 5)
    for _ in range(2):
        served.withdraw()
    assert page.drive(5, 5) == {"done": True}
    assert record(served.plan).end == "the participation ended"
    assert served.state().json["kind"] == "end"
    again = served.act("restart", page=1)
    assert (again.status, "can be begun again" in again.json["error"]) == (400, True)
    person = served.act("end").json["people"][0]
    assert (person["drives"], person["rows"]) == ([], None)
    ends = [event for event in events(served.plan) if event["kind"] == "end"]
    assert [event["source"] for event in ends] == ["participant"]
    table = tl.read_live_study(served.plan.folder).participants
    assert table["withdrawn"].tolist() == [True, True, False]
    seen = [person["withdrawn"] for person in served.overview()["people"]]
    assert seen == [True, True, False]


def test_who_is_deleted_while_the_study_is_served_is_gone(served, client, page):
    page.drive(0, 5)
    served.plan.delete("P01")
    assert client(served.links["P01"]).status == served.state().status == 404
    assert page.drive(5, 5) == {"done": True}
    assert not (served.plan.folder / "P01").exists()
    seen = served.overview()
    assert (seen["deleted"], [person["code"] for person in seen["people"]]) == (1, ["P02", "P03"])
    study = tl.read_live_study(served.plan.folder)
    assert study.deleted == ["P01"]
    assert study.faults().empty
    assert "1 deleted" in study.summary()


def test_nothing_about_a_person_who_drove_is_kept_but_what_the_documentation_lists(
    served, driving_page
):
    """
    Names of everything that an event or a log may hold; a new one belongs into the documentation
    first.
    """
    served.consent(User_Agent="Mozilla/5.0 (secret)", Cookie="a=b")
    page = driving_page(
        served.links["P01"], header={"User-Agent": "Mozilla/5.0 (secret)", "X-Real-IP": "10.1.2.3"}
    )
    page.begin()
    assert page.drive(0, 5)["done"] is False
    page.say(note="paused")
    assert page.drive(5, 99)["done"] is True
    assert page.drive(100, 5) == {"done": True}
    assert served.state().json["page"] == 2
    done = record(served.plan)
    assert (len(done.rows), done.end) == (100, "complete")
    assert [event["kind"] for event in events(served.plan)] == ["page", "begin", "page"]
    kept = {key for event in events(served.plan) for key in event}
    about = {"at", "kind", "page", "name", "answers", "condition", "position", "attempt", "rows"}
    assert kept == about | {"link"}
    path = served.plan.folder / "P01" / "01-training.jsonl"
    header, *rest = entries(path)
    assert set(header) == {"settings", "version", "sources", "condition", "source", "why"}
    kept = {key for entry in rest for key in entry}
    assert kept == {"at", "window", "note", "commands", "seen", "rows", "end"}
    words = "".join(path.read_text() for path in served.plan.folder.rglob("*") if path.is_file())
    assert not re.search(r"Mozilla|secret|10\.1\.2\.3|127\.0\.0\.1", words)
    assert np.isfinite([event["at"] for event in events(served.plan)]).all()


def nonsense(rng, depth=0):
    """A random value that JSON can hold, of names and numbers that the server knows or not."""
    kind = rng.integers(9 if depth < 3 else 6)
    if kind == 6:
        return [nonsense(rng, depth + 1) for _ in range(rng.integers(4))]
    if kind >= 7:
        names = ["page", "answers", "late", "consent", "participant", "action", "text", "window"]
        names += ["begin", "k", "commands", "seen", "note", "", "\ud800", "__class__"]
        keys = rng.choice(names, rng.integers(6))
        return {str(key): nonsense(rng, depth + 1) for key in keys}
    words = ["P01", "restart", "note", "end", "a" * 50, "\0", "<b>", "\udfff", "NaN", "1"]
    known = (None, True, 0, 1, -1, 1.5, 10**30, 1e308, -0.0)
    return str(rng.choice(words)) if kind < 2 else known[rng.integers(len(known))]


@pytest.mark.parametrize("count", [300, pytest.param(1500, marks=pytest.mark.long)])
def test_random_bodies_and_messages_make_no_mistake(served, client, page, count):
    """What is refused is refused by a number below 500, and lets nothing in."""
    rng = np.random.default_rng(0)
    experimenter = served.server.experimenter
    links = [f"{served.links['P02']}/answers", f"{experimenter}/act", f"{served.links['P02']}/x"]
    links += [f"{served.base}/join/{'x' * 22}", f"{served.base}/p/{'y' * 22}/answers"]
    statuses = [client(links[k % 5], nonsense(rng)).status for k in range(count)]
    assert max(statuses) < 500
    assert "This page cannot go on" in page.say(k=0, commands=[[9.0, 0.1, 1]], seen=0)["refused"]
    texts = ["", "{", "[]", "3", '{"k": NaN}', "[" * 5000, '"\\ud83d"']
    for text in [*texts, *(json.dumps(nonsense(rng)) for _ in range(count))]:
        page.socket.send(text)
        answer = json.loads(page.socket.recv())
        assert {"refused", "other_window", "k", "done"} & set(answer), answer
        assert text not in texts or "refused" in answer
    assert record(served.plan).commands == []
    assert served.server.mistakes == []
    assert page.begin()["done"] is False
    study = tl.read_live_study(served.plan.folder)
    assert study.faults().empty
    assert study.export().exists()


def test_a_link_that_somebody_reads_by_is_given_to_nobody_else(make_plan, serving, client):
    with serving(make_plan(participants=2), enrol=True) as served:
        join = served.overview()["join"]
        assert served.state("P01").json["page"] == 0
        places = [client(join, {}) for _ in range(2)]
        assert [place.status for place in places] == [200, 409]
        assert served.base + places[0].json["link"] == served.links["P02"]

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
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from threading import Barrier, Event

import numpy as np
import pytest

from tests.cases import refused
from tests.live.cases import DrivingPage, advance, ask, entries, events, record, recorded
from trustlab.live.study.plan import read_tokens, tokens_path
from trustlab.live.study.server import StudyServer

CONSENT = {"page": 0, "answers": {"consent": True}}
END = {"participant": "P01", "action": "end"}


def kinds(served):
    return [event["kind"] for event in events(served.plan)]


# who may ask
# --------------------------------------------------------------------------------------------------


def test_who_asks_from_elsewhere_changes_nothing(served):
    import websocket

    link, port = served.link, served.server.port
    own, far = f"127.0.0.1:{port}", "attacker.invalid"
    for host in (far, f"{far}:{port}", "127.0.0.1", f"127.0.0.1:{port + 1}"):
        assert ask(f"{link}/state", Host=host).status in (400, 421), host
    assert ask(f"{link}/state", Host=f"localhost:{port}").status == 200
    for origin in (None, "null", f"http://{far}", f"https://{own}", f"http://{own}/"):
        for path in (f"{link}/answers", f"{served.server.experimenter}/act"):
            assert ask(path, CONSENT | END, Origin=origin).status == 403
    served.consent()
    for place, options, said in (
        (link, {"origin": f"http://{far}"}, "403"),
        (link, {"host": far}, "421"),
        (f"{served.base}/p/{'x' * 22}", {}, "404"),
        (served.server.experimenter, {}, "404"),
    ):
        with pytest.raises(websocket.WebSocketBadStatusException, match=said):
            DrivingPage(place, **options)
    assert kinds(served) == ["page"]


def test_wrong_tokens_lead_nowhere(served):
    tokens = read_tokens(served.plan.folder)
    token, experimenter = tokens["P01"], tokens[".experimenter"]
    near = [token.swapcase(), token[:-1], f"{token}x", f"{token[:-1]}{'BA'[token[-1] == 'B']}"]
    wrong = [f"p/{each}" for each in (*near, experimenter, "P01", "")]
    for place in (*wrong, f"experimenter/{token}"):
        for path, body in (("", None), ("/state", None), ("/answers", CONSENT), ("/act", END)):
            assert ask(f"{served.base}/{place}{path}", body).status == 404, place
    assert kinds(served) == []


def test_paths_lead_to_no_other_file(served):
    token = read_tokens(served.plan.folder)["P01"]
    assert ask(f"{served.base}/static/page.js").status == 200
    for path in (
        "/static/../study/plan.py",
        "/static/%2e%2e/study/plan.py",
        "/static//etc/passwd",
        "/static/page.js%00.html",
        "/mystudy/study.json",
        f"/p/{token}/events.jsonl",
        f"/p/{token}/experimenter_end",
        "/",
    ):
        for body in (None, {}):
            answer = ask(served.base, body, path)
            assert answer.status in (400, 404, 405), (path, answer.status)
            assert token.encode() not in answer.content


def test_answers_tell_browsers_to_run_and_fetch_nothing_else(served):
    link, base = served.link, served.base
    for path in (link, f"{link}/state", f"{base}/static/page.js", f"{base}/none"):
        headers = ask(path).headers
        policy = headers["Content-Security-Policy"]
        assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self';")
        assert "unsafe-inline" not in policy
        names = ("X-Content-Type-Options", "Referrer-Policy", "Cache-Control", "Server")
        said = [headers[name] for name in names]
        assert said == ["nosniff", "no-referrer", "no-store", "study"]
    words = b"".join(served.server.files.values()).replace(b"http://www.w3.org/2000/svg", b"")
    forbidden = rb"https?://|innerHTML|eval\(|document\.write|insertAdjacentHTML"
    assert not re.search(forbidden, words)
    assert tokens_path(served.plan.folder).stat().st_mode & 0o777 == 0o600


def test_the_participant_is_told_no_condition(served, page):
    link, participant = served.link, served.server.participant("P01")
    said = [served.state().json, page.drive(0, 5)]
    number = advance(participant, "drive")
    stand_in = served.plan.content["stand_in"]
    participant.add("model", page=2, attempt=0, source="", why="", **stand_in)
    said += [served.state().json, DrivingPage(link, number).begin()]
    assert "columns" in said[-1]["config"]
    assert not re.search(r"\bC[1-5]\b", json.dumps(said) + str(ask(link).content))
    drive = record(served.plan, name=f"{number:02d}-drive")
    assert drive.settings["condition"] == served.plan.orders["P01"][0]  # the lab knows


# how much
# --------------------------------------------------------------------------------------------------


def test_connections_are_capped_and_slow_heads_time_out(make_plan, serving, monkeypatch):
    monkeypatch.setattr("trustlab.live.study.server.HEADER_TIME", 2.0)
    monkeypatch.setattr("trustlab.live.study.server.MOST_CONNECTIONS", 100)
    with serving(make_plan()) as served, ExitStack() as held:
        place = ("127.0.0.1", served.server.port)
        links = [held.enter_context(socket.create_connection(place, 30)) for _ in range(150)]
        closed = 0
        for link in links[-20:]:
            link.settimeout(2.0)
            with suppress(TimeoutError, ConnectionError):
                closed += link.recv(1) == b""
        assert closed == 20, "beyond a hundred"
        for link in links[50:]:
            link.close()
        began = time.monotonic()
        for link in links[:50]:
            link.sendall(b"GET /")
        assert links[0].recv(100) == b""
        assert 0.5 < time.monotonic() - began < 15.0
        assert served.state().status == 200


def test_a_mistake_is_logged_once_and_counted(served, monkeypatch, caplog):
    def wrong(body):
        raise RuntimeError("a mistake")

    monkeypatch.setattr(served.server.participant("P01"), "state", wrong)
    assert [served.state().status for _ in range(2)] == [500, 500]
    assert caplog.text.count("could not be answered") == 1
    assert "2 requests could not be answered" in served.overview()["trouble"]


def test_many_participants_may_have_more_files_than_a_process_usually_has(make_plan, serving):
    limit = resource.RLIMIT_NOFILE
    soft, hard = resource.getrlimit(limit)
    plan = make_plan(participants=60)
    resource.setrlimit(limit, (len(os.listdir("/proc/self/fd")) + 20, hard))
    try:
        with serving(plan) as served:
            assert served.state("P60").status == 200
    finally:
        resource.setrlimit(limit, (soft, hard))


# what is kept
# --------------------------------------------------------------------------------------------------


def test_a_disk_that_is_full_acknowledges_nothing(served, page, full_disk, caplog):
    with full_disk():
        for _ in range(2):
            assert "cannot save at the moment" in page.drive(0, 5)["trouble"]
        assert "saved (No space left on device)" in served.overview()["trouble"]
    assert caplog.text.count("No space left") == 1, "one line however often it is tried"
    assert "Traceback" not in caplog.text
    assert read_tokens(served.plan.folder)["P01"] not in caplog.text  # no place for links
    assert page.drive(0, 5)["k"] == len(record(served.plan).commands) == 5
    assert served.overview()["trouble"] == ""
    assert "is saved again" in caplog.text


def test_a_slow_disk_holds_up_its_own_log_only(served, page, monkeypatch):
    served.consent("P02")
    other = DrivingPage(served.links["P02"])
    other.begin()
    slow, sync = served.server.participant("P01").trial.log.handle, os.fsync
    done = Event()

    def synced(handle):
        assert handle != slow or done.wait(60.0)
        sync(handle)

    monkeypatch.setattr(os, "fsync", synced)
    page.send(k=0, commands=[[0.3, 0.1, 1]], seen=0)
    assert [other.drive(k, 1)["k"] for k in range(5)] == [1, 2, 3, 4, 5]
    done.set()
    assert page.hear()["k"] == 1


def test_a_second_click_and_a_second_window_find_the_page_done(served):
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda _: served.consent(), range(8)))
    assert sorted(answer.status for answer in answers) == [200, *[409] * 7]
    assert kinds(served) == ["page"]


def test_a_failed_start_lets_the_study_go(make_plan):
    plan = make_plan()
    path = tokens_path(plan.folder)
    path.chmod(0o644)
    with refused("can be read by others"), StudyServer(plan):
        pass
    path.chmod(0o600)
    with StudyServer(plan), refused("is being served already"), StudyServer(plan):
        pass
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        kept = StudyServer(plan, port)  # as by the traceback in a notebook
        with refused(f"cannot be served on port {port}"), kept:
            pass
    StudyServer(plan).__enter__().__exit__()


@pytest.mark.parametrize("lost", ["lines", "file", "folder"])
def test_events_that_were_lost_are_not_gone_on_behind(make_plan, serving, lost):
    """Else the last link would be written anew, and nobody could see that there had been more."""
    plan = make_plan()
    with serving(plan) as served:
        served.consent()
        served.withdraw()
    folder = plan.folder / "P01"
    path = folder / "events.jsonl"
    whole = path.read_text()
    path.write_text(whole.partition("\n")[0] + "\n")
    if lost != "lines":
        path.unlink()
    if lost == "folder":
        folder.rmdir()
    with serving(plan) as served:
        answer = ask(f"{served.base}/p/{read_tokens(plan.folder)['P01']}/state")
        assert (answer.status, "cannot go on here" in answer.json["error"]) == (409, True)
        assert served.state("P02").status == 200  # the others go on
        assert (
            "events.jsonl: its last lines are missing; restore it" in served.overview()["trouble"]
        )
    assert recorded(plan).faults()["participant"].tolist() == ["P01"]
    folder.mkdir(exist_ok=True)
    path.write_text(whole)
    with serving(plan) as served:
        assert served.link


def test_enrolment_and_requests_at_once_break_no_log(make_plan, serving):
    with serving(make_plan(participants=20), enrol=True) as served:
        join, barrier = served.overview()["join"], Barrier(40)

        def both(k):
            barrier.wait()
            return ask(join, {}) if k % 2 else served.consent(f"P{1 + k // 2:02d}")

        with ThreadPoolExecutor(40) as pool:
            list(pool.map(both, range(40)))
    assert served.study.faults().empty
    assert all(len(each.events) in (1, 2) for each in served.study.records.values())


def test_only_a_proxy_leads_people_here_from_other_machines(make_plan):
    plan = make_plan()
    for wrong in ("https://lab.test/study", "ftp://lab.test", "https://me:pw@lab.test", 5):
        with refused("url must be like https://study"):
            StudyServer(plan, url=wrong)
    assert StudyServer(plan, url="https://Lab.Test/").url == "https://lab.test"
    assert {"127.0.0.1", "localhost", "127.0.0.1:80"} <= StudyServer(plan, 80).hosts
    with StudyServer(plan, url="https://lab.test:443") as server:
        link = server.links()["P01"]
        assert link.startswith("https://lab.test/p/")
        here = link.replace("https://lab.test", f"http://127.0.0.1:{server.port}")
        assert ask(f"{here}/state", Host="lab.test").status == 200
        body = {"Host": "lab.test", "Origin": "https://lab.test"}
        assert ask(f"{here}/answers", CONSENT, **body).status == 200


def test_all_that_people_see_is_in_the_language_of_the_study(make_plan, serving):
    plan = make_plan(participants=1, language="de")
    (plan.folder / "P01" / "events.jsonl").write_text('["0", {}]\n')
    with serving(plan, enrol=True) as served:
        join, token = served.overview()["join"], read_tokens(plan.folder)["P01"]
        page = ask(join).content.decode()
        for words in ('<html lang="de">', "<title>Eine Studie</title>", "Studie öffnen"):
            assert words in page
        lost = ask(f"{served.base}/p/{'x' * 22}", Accept="text/html").content.decode()
        assert lost.count("Dieser Link führt zu keiner Studie") == 2
        for answer, said in (
            (ask(join, {}), "Alle Plätze dieser Studie sind vergeben"),
            (ask(f"{served.base}/p/{token}/state"), "Die Studie kann hier nicht weitergehen"),
        ):
            assert answer.json["error"].startswith(said)


def test_a_page_that_is_left_while_it_is_answered_is_no_mistake(page, monkeypatch, caplog):
    sync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda handle: (time.sleep(0.1), sync(handle)))
    for _ in range(5):
        page.send(note="x")
    page.socket.sock.close()
    time.sleep(1.5)
    gc.collect()
    assert "WebSocketClosedError" not in caplog.text


# the experimenter
# --------------------------------------------------------------------------------------------------


def test_the_experimenter_restarts_a_drive_and_the_old_one_is_kept(served, page):
    page.drive(0, 5)
    for number, status in ((0, 400), (2, 400), ([1], 400), (1, 200)):  # no drive, not begun, begun
        assert served.act("restart", page=number).status == status
    assert page.drive(5, 5) == {"done": True}
    begun = DrivingPage(served.link).begin()
    assert (begun["k"], begun["config"]["attempt"]) == (0, 1)
    first, second = record(served.plan), record(served.plan, name="01-training.2")
    assert (len(first.rows), first.end) == (5, "the experimenter let it be driven again")
    assert first.settings["seed"] != second.settings["seed"]
    assert served.study.faults().empty


def test_what_cannot_be_noted_ends_no_drive(served, page, monkeypatch):
    """Else the drive would be over, and what there is of it would count as all."""
    page.drive(0, 5)

    def full(entries):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(served.server.participant("P01").log, "append", full)
        for act in ("restart", "end"):
            assert served.act(act, page=1).status == 507
    assert page.drive(5, 5)["k"] == 10
    assert record(served.plan).end == ""


def test_the_experimenter_sees_adds_and_ends(served, page):
    page.drive(0, 5)
    words = "<script>alert(1)</script> spoke"
    one, two, _ = served.act("note", text=words).json["people"]
    assert (one["rows"], one["delay"], two["seconds_ago"]) == (5, 0.0, None)
    assert [note["text"] for note in one["notes"]] == [words]
    long = served.act("note", text="x" * 1001)
    assert long.json["error"].startswith("note: the answer must be 1 to 1000 characters")
    for answer in (long, served.act("end", participant=[]), served.act("overview")):
        assert answer.status == 400
    served.act("end")
    assert served.state().json["kind"] == "end"
    person = served.study.participants.iloc[0]
    assert (person["ended"], person["notes"]) == (True, words)


def test_people_decline_and_withdraw(served, page):
    assert served.withdraw("P02").json["title"] == "You have stopped"
    page.drive(0, 5)
    for _ in range(2):
        served.withdraw()
    assert page.drive(5, 5) == {"done": True}
    assert record(served.plan).end == "the participation ended"
    again = served.act("restart", page=1)
    assert (again.status, "can be begun again" in again.json["error"]) == (400, True)
    people = served.act("end").json["people"]
    assert (people[0]["drives"], people[0]["rows"]) == ([], None)
    assert kinds(served) == ["page", "begin", "end"]
    table = served.study.participants["withdrawn"].tolist()
    assert table == [person["withdrawn"] for person in people] == [True, True, False]


def test_who_is_deleted_while_the_study_is_served_is_gone(served, page):
    page.drive(0, 5)
    served.plan.delete("P01")
    assert ask(served.link).status == served.state().status == 404
    assert page.drive(5, 5) == {"done": True}
    assert not (served.plan.folder / "P01").exists()
    seen = served.overview()
    assert (seen["deleted"], [person["code"] for person in seen["people"]]) == (1, ["P02", "P03"])
    study = served.study
    assert (study.deleted, study.faults().empty) == (["P01"], True)
    assert "1 deleted" in study.summary()


def test_nothing_about_a_person_who_drove_is_kept_but_what_the_documentation_lists(served):
    """
    Names of everything that an event or a log may hold; a new one belongs into the documentation
    first.
    """
    browser = {"User-Agent": "Mozilla/5.0 (secret)", "X-Real-IP": "10.1.2.3", "Cookie": "a=b"}
    served.consent(**browser)
    page = DrivingPage(served.link, header=browser)
    page.begin()
    page.drive(0, 5)
    page.say(note="paused")
    assert page.drive(5, 99)["done"]
    assert page.drive(100, 5) == {"done": True}
    assert len(record(served.plan).rows) == 100
    assert kinds(served) == ["page", "begin", "page"]
    about = {"at", "kind", "page", "name", "answers", "condition", "position", "attempt", "rows"}
    assert set().union(*events(served.plan)) == about | {"link"}
    header, *rest = entries(served.plan.folder / "P01" / "01-training.jsonl")
    assert set(header) == {"settings", "version", "sources", "source"}
    kept = {"at", "window", "note", "commands", "seen", "rows", "end"}
    assert set().union(*rest) == kept
    words = "".join(path.read_text() for path in served.plan.folder.rglob("*.json*"))
    assert not re.search(r"Mozilla|secret|10\.1\.2\.3|127\.0\.0\.1", words)


NAMES = "page answers late consent participant action text window begin k commands seen note"
KNOWN = [None, True, 0, 1, -1, 1.5, 10**30, 1e308, "P01", "restart", "note", "end", "a" * 50, "\0"]


def nonsense(rng, depth=0):
    """A random value that JSON can hold, of names and numbers that the server knows or not."""
    kind = rng.integers(9 if depth < 3 else 6)
    count = rng.integers(6)
    if kind == 6:
        return [nonsense(rng, depth + 1) for _ in range(count)]
    if kind > 6:
        keys = rng.choice([*NAMES.split(), "", "\ud800", "__class__"], count)
        return {str(key): nonsense(rng, depth + 1) for key in keys}
    values = [*KNOWN, "<b>", "\udfff", "NaN", "1", -0.0]
    return values[rng.integers(len(values))]


@pytest.mark.parametrize("count", [300, pytest.param(1500, marks=pytest.mark.long)])
def test_random_bodies_and_messages_make_no_mistake(served, page, count):
    """What is refused is refused by a number below 500, and lets nothing in."""
    rng = np.random.default_rng(0)
    other, base = served.links["P02"], served.base
    links = [f"{other}/answers", f"{served.server.experimenter}/act", f"{other}/x"]
    links += [f"{base}/join/{'x' * 22}", f"{base}/p/{'y' * 22}/answers"]
    assert max(ask(links[k % 5], nonsense(rng)).status for k in range(count)) < 500
    assert "This page cannot go on" in page.drive(0, 1, [9.0, 0.1, 1])["refused"]
    texts = ["", "{", "[]", "3", '{"k": NaN}', "[" * 5000, '"\\ud83d"']
    for text in [*texts, *(json.dumps(nonsense(rng)) for _ in range(count))]:
        page.socket.send(text)
        answer = page.hear()
        assert {"refused", "other_window", "k", "done"} & set(answer), answer
        assert text not in texts or "refused" in answer
    assert record(served.plan).commands == []
    assert served.server.mistakes == []
    assert not page.begin()["done"]
    assert served.study.faults().empty

"""
The server of a live study, on tornado: a participant's pages, the rows of their drives, and the
experimenter's page.

A link is a token of 128 bits; who has it is that participant. Pages change by what is appended to
the participant's events, one request of a participant after another; nothing is acknowledged before
it is on the disk.
"""

from __future__ import annotations

import asyncio
import json
import os
import secrets
import ssl
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Self

from trustlab.live.chain import check_writable, hold
from trustlab.live.study.drives import kernel_digest, prepare
from trustlab.live.study.pages import AnswerError
from trustlab.live.study.participation import Participation, RefusedError
from trustlab.live.study.plan import Plan
from trustlab.live.study.store import (
    EXPERIMENTER,
    JOIN,
    PREVIEW,
    DeletedError,
    read_tokens,
    tokens_path,
)
from trustlab.models.checks import flag, whole_number
from trustlab.models.extras import extra

with extra("live"):
    import tornado.httpserver
    import tornado.log
    import tornado.netutil
    import tornado.web

STATIC = Path(__file__).parents[1] / "static"
TYPES = {
    ".js": "text/javascript",
    ".css": "text/css",
    ".wasm": "application/wasm",
    ".html": "text/html",
    ".svg": "image/svg+xml",
}
LOOPBACK = ("127.0.0.1", "::1", "localhost")
LARGEST_BODY = 400_000
"""Bytes of a request; 600 rows of a drive, what is sent at once after an outage, have 200,000."""

RATE, BURST = 20.0, 60.0
"""
Requests per second of one link, and how many may come at once; a browser sends two or three a
second.
"""

POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; connect-src "
    "'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Server": "study",
}


class Bucket:
    """How many requests a link may still make."""

    def __init__(self):
        self.left, self.at = BURST, time.monotonic()

    def take(self) -> bool:
        """Count one request; say whether it may be answered."""
        now = time.monotonic()
        self.left, self.at = min(BURST, self.left + RATE * (now - self.at)), now
        self.left -= self.left >= 1.0
        return self.left >= 1.0


class Base(tornado.web.RequestHandler):
    """
    What every request goes through: host, origin, kind and rate are checked before anything is
    read.
    """

    def set_default_headers(self) -> None:
        """Set the headers that all answers have, errors too."""
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Refuse what does not come from the study's own pages."""
        if (
            self.request.host not in self.served.hosts
        ):  # another name for this address: DNS rebinding
            raise tornado.web.HTTPError(421)
        if self.request.method == "POST":
            if (
                self.request.headers.get("Origin")
                != f"{self.request.protocol}://{self.request.host}"
            ):
                raise tornado.web.HTTPError(403)
            if self.request.headers.get("Content-Type", "").partition(";")[0] != "application/json":
                raise tornado.web.HTTPError(415)

    @property
    def served(self) -> StudyServer:
        """The server."""
        return self.settings["served"]

    def holder(self, token: str) -> str:
        """Return whose link this is; an unknown one is as if the page did not exist."""
        holder = self.served.holder(token)
        if holder is None:
            raise tornado.web.HTTPError(404)
        if not self.served.buckets.setdefault(holder, Bucket()).take():
            raise tornado.web.HTTPError(429)
        return holder

    def body(self) -> dict[str, Any]:
        """Return the request's body, an object in JSON without NaN and infinities."""
        try:
            body = json.loads(self.request.body, parse_constant=_refuse)
        except (ValueError, RecursionError):
            raise tornado.web.HTTPError(400) from None
        if not isinstance(body, dict):
            raise tornado.web.HTTPError(400)
        return body

    def page(self, name: str) -> None:
        """Answer with a file of this package."""
        content = self.served.files.get(name)
        if content is None:
            raise tornado.web.HTTPError(404)
        self.set_header("Content-Type", f"{TYPES[Path(name).suffix]}; charset=utf-8")
        self.write(content)

    def write_error(self, status_code: int, **_: Any) -> None:
        """
        Answer with nothing about the server: the number of the error, or a page for who opened a
        link that leads nowhere.
        """
        opened = self.request.method == "GET" and "text/html" in self.request.headers.get(
            "Accept", ""
        )
        if status_code == 404 and opened:
            self.page("missing.html")
            self.finish()
        else:
            self.finish({"error": status_code})

    def log_exception(self, kind: Any, value: Any, traceback: Any) -> None:
        """Log a mistake of ours, without the address of the request, which is somebody's link."""
        if not isinstance(value, tornado.web.HTTPError):
            self.served.mistakes += 1
            tornado.log.app_log.error(
                "a request could not be answered", exc_info=(kind, value, traceback)
            )

    def data_received(self, chunk: bytes) -> None:
        """Bodies are read whole."""


def _refuse(constant: str) -> None:
    raise ValueError(constant)


class Static(Base):
    """
    The scripts, the style sheet and the physics: files known by name when the server starts, and no
    others.
    """

    def get(self, name: str) -> None:
        """Answer with the file."""
        self.page(name)


class ParticipantPage(Base):
    """The page that a link opens."""

    def get(self, token: str) -> None:
        """Answer with the frame that the script fills; a preview begins anew."""
        holder = self.holder(token)
        if holder in (EXPERIMENTER, JOIN):
            raise tornado.web.HTTPError(404)
        if holder == PREVIEW:
            self.served.begin_preview()
        self.page("study.html")


class Join(Base):
    """The link by which anybody takes the next free place."""

    async def get(self, token: str) -> None:
        """Lead to a participant's page, or say that all places are taken."""
        if self.holder(token) != JOIN or not self.served.enrol:
            raise tornado.web.HTTPError(404)
        code = await asyncio.to_thread(self.served.free_place)
        if code is None:
            self.set_status(410)
            self.finish("All places of this study are taken. Thank you for your interest.")
        else:
            self.redirect(f"/p/{self.served.tokens[code]}")


class ParticipantRequest(Base):
    """What a participant's page asks and tells."""

    async def get(self, token: str, request: str) -> None:
        """Answer with the page to show."""
        if request != "state":
            raise tornado.web.HTTPError(405)
        await self.reply(token, lambda participation: participation.state())

    async def post(self, token: str, request: str) -> None:
        """Take answers, rows, notes and the end of a drive."""
        if request == "state":
            raise tornado.web.HTTPError(405)
        body = self.body()
        await self.reply(token, lambda participation: getattr(participation, request)(body))

    async def reply(self, token: str, work: Callable[[Participation], dict[str, Any]]) -> None:
        """
        Do the work in a thread, after what this participant asked before, and answer with what it
        returns.
        """
        code = self.holder(token)
        if code in (EXPERIMENTER, JOIN):
            raise tornado.web.HTTPError(404)
        async with self.served.locks.setdefault(code, asyncio.Lock()):
            try:
                self.write(await asyncio.to_thread(lambda: work(self.served.participation(code))))
                if self.request.method == "POST":
                    self.served.saved()
            except OSError as error:
                self.served.not_saved(error)
                self.set_status(507)
                self.finish({"error": "the disk is full"})
            except AnswerError as error:
                self.set_status(400)
                self.finish({"error": str(error)})
            except RefusedError as error:
                self.set_status(409)
                self.finish({"error": str(error), **error.facts})
            except DeletedError:
                raise tornado.web.HTTPError(404) from None


class ExperimenterPage(Base):
    """The page that shows who is where."""

    def get(self, token: str) -> None:
        """Answer with the frame that the script fills."""
        if self.holder(token) != EXPERIMENTER:
            raise tornado.web.HTTPError(404)
        self.page("experimenter.html")


class ExperimenterRequest(Base):
    """What the experimenter's page asks and tells."""

    async def get(self, token: str, request: str) -> None:
        """Answer with where everybody is, or with everything as a zip."""
        self.allow(token, request in ("state", "export"))
        if request == "export":
            return await self.export()
        self.write(await asyncio.to_thread(self.served.overview))

    async def export(self) -> None:
        """Answer with everything that was recorded, as a zip."""
        # Only here: a server that comes back after a crash needs no analysis.
        from trustlab.live.study.recorded import read_live_study

        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "data.zip"
            folder_of_study = self.served.plan.folder
            await asyncio.to_thread(lambda: read_live_study(folder_of_study).export(path))
            self.set_header("Content-Type", "application/zip")
            name = f'attachment; filename="{folder_of_study.name}.zip"'
            self.set_header("Content-Disposition", name.encode("ascii", "replace"))
            self.write(path.read_bytes())

    async def post(self, token: str, request: str) -> None:
        """Restart a drive, add a note, or end a participation."""
        self.allow(token, request == "act")
        body = self.body()
        code, action = body.get("participant"), body.get("action")
        if code not in self.served.present() or action not in ("restart", "note", "end"):
            raise tornado.web.HTTPError(400)
        async with self.served.locks.setdefault(code, asyncio.Lock()):
            try:
                await asyncio.to_thread(
                    lambda: getattr(self.served.participation(code), f"experimenter_{action}")(body)
                )
            except AnswerError as error:
                self.set_status(400)
                self.finish({"error": str(error)})
                return
            except OSError as error:
                self.served.not_saved(error)
                self.set_status(507)
                self.finish({"error": f"nothing can be saved: {self.served.disk}"})
                return
        self.write(await asyncio.to_thread(self.served.overview))

    def allow(self, token: str, known: bool) -> None:
        """Turn away who is not the experimenter, and what is not known."""
        if self.holder(token) != EXPERIMENTER or not known:
            raise tornado.web.HTTPError(404)


class StudyServer:
    """
    A study's server in a thread of its own: a context manager, which serves from its beginning to
    its end.

    Parameters
    ----------
    plan, address, port, certificate, key, names, enrol
        As for `LiveStudy.serve`.
    """

    def __init__(
        self,
        plan: Plan,
        address: str = "127.0.0.1",
        port: int = 0,
        *,
        certificate: str | os.PathLike | None = None,
        key: str | os.PathLike | None = None,
        names: Iterable[str] = (),
        enrol: bool = False,
    ):
        if certificate is None and address not in LOOPBACK:
            raise ValueError(
                f"address {address!r} can be reached from other machines, and what people type "
                "there would travel unencrypted: give certificate= and key= (files in PEM "
                "format), or serve on 127.0.0.1 behind a proxy that has them"
            )
        if key is not None and certificate is None:
            raise ValueError(f"key {str(key)!r} is of no use without certificate=")
        if plan.content["kernel"] != kernel_digest():
            raise ValueError(
                f"the study was frozen with physics {plan.content['kernel'][:16]}, this version "
                f"of trustlab has {kernel_digest()[:16]}: its drives would not compare; go on "
                "with the version it was begun with"
            )
        if plan.fault:
            raise ValueError(
                f"{plan.fault} after it was frozen: restore it from a copy before it is served"
            )
        self.plan = plan
        self.address = address
        self.port = whole_number("port", port, 0, 65535)
        self.tls = None
        if certificate is not None:
            self.tls = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
            try:
                self.tls.load_cert_chain(certificate, key)
            except OSError as error:  # ssl.SSLError is one
                files = (
                    f"certificate {str(certificate)!r} and key {str(key)!r}"
                    if key
                    else f"certificate {str(certificate)!r}"
                )
                raise ValueError(
                    f"{files} cannot be used for TLS ({error}); give files in PEM format, the key "
                    "without a password"
                ) from error
        self.names = tuple(names)
        self.enrol = flag("enrol", enrol)
        self.files = {
            path.name: path.read_bytes() for path in STATIC.iterdir() if path.suffix in TYPES
        }
        self.hosts: set[str] = set()
        self.buckets: dict[str, Bucket] = {}
        self.locks: dict[str, asyncio.Lock] = {}
        self.participations: dict[str, Participation] = {}
        self.participations_lock = threading.Lock()
        self.places_lock = threading.Lock()
        self.tokens: dict[str, str] = {}
        self.tokens_at = 0
        self.thread: threading.Thread | None = None
        self.started = threading.Event()
        self.fault: BaseException | None = None
        self.disk = ""
        self.mistakes = 0

    def holder(self, token: str) -> str | None:
        """
        Return whose token this is; the file is read again when it has changed, as when someone was
        deleted.
        """
        at = tokens_path(self.plan.folder).stat().st_mtime_ns
        if at != self.tokens_at:
            self.tokens, self.tokens_at = read_tokens(self.plan.folder), at
        holder = None
        for name, known in self.tokens.items():  # all are compared: the time taken tells nothing
            if secrets.compare_digest(known.encode(), token.encode()):
                holder = name
        return holder

    def participation(self, code: str) -> Participation:
        """Return a participant's participation, read from the disk the first time."""
        with self.participations_lock:
            if code not in self.participations or self.participations[code].participant.deleted:
                self.participations.pop(code, None)
                if code not in self.present():
                    raise DeletedError(f"participant {code} was deleted")
                self.participations[code] = Participation(self.plan, code)
            return self.participations[code]

    def begin_preview(self) -> None:
        """Let a preview begin anew: a rehearsal of the plan in a folder that does not last."""
        self.preview_home = tempfile.TemporaryDirectory()
        content = {**self.plan.content, "rehearsal": True}
        plan = Plan(Path(self.preview_home.name), content)
        code = next(iter(plan.orders))
        (plan.folder / code).mkdir()
        self.participations[PREVIEW] = Participation(plan, code)

    def free_place(self) -> str | None:
        """Return the next participant whom nobody is yet, and take the place."""
        with self.places_lock:
            return next((c for c in self.present() if self.participation(c).enrol()), None)

    def present(self) -> list[str]:
        """Return the codes of all who were not deleted."""
        gone = self.plan.deleted()
        return [code for code in self.plan.orders if code not in gone]

    def saved(self) -> None:
        """Note that something was written again after a time when nothing could be."""
        if self.disk:
            self.disk = ""
            tornado.log.app_log.error("what people do is saved again")

    def not_saved(self, error: OSError) -> None:
        """Note that nothing can be written; the log gets one line until it can."""
        if not self.disk:
            self.disk = error.strerror or str(error)
            tornado.log.app_log.error("what people do cannot be saved: %s", self.disk)

    @property
    def trouble(self) -> str:
        """What the experimenter must know of the server itself."""
        parts = []
        if self.disk:
            parts.append(
                f"Nothing can be saved ({self.disk}): make room on the disk of "
                f"{self.plan.folder.name}. Nothing is lost; participants' pages wait, and go on by "
                "themselves."
            )
        if self.mistakes:
            parts.append(
                f"{self.mistakes} requests could not be answered because of a mistake in the "
                "server; its terminal shows which."
            )
        return " ".join(parts)

    def overview(self) -> dict[str, Any]:
        """Return what the experimenter's page shows."""
        rows = [
            self.participation(code).overview() | {"link": f"{self.base}/p/{self.tokens[code]}"}
            for code in self.present()
        ]
        return {
            "study": self.plan.folder.name,
            "rehearsal": self.plan.rehearsal,
            "deleted": len(self.plan.deleted()),
            "trouble": self.trouble,
            "preview": f"{self.base}/p/{self.tokens[PREVIEW]}",
            "join": f"{self.base}/join/{self.tokens[JOIN]}" if self.enrol else "",
            "people": rows,
        }

    @property
    def base(self) -> str:
        """The beginning of every link."""
        name = (
            self.names[0]
            if self.names
            else f"[{self.address}]"
            if ":" in self.address
            else self.address
        )
        return f"{'https' if self.tls else 'http'}://{name}:{self.port}"

    @property
    def experimenter(self) -> str:
        """The experimenter's link."""
        return f"{self.base}/experimenter/{self.tokens[EXPERIMENTER]}"

    def links(self) -> dict[str, str]:
        """Return the link of every participant, by code."""
        return {row["code"]: row["link"] for row in self.overview()["people"]}

    def application(self) -> tornado.web.Application:
        """
        Return the addresses that are answered; requests are not logged, as their addresses hold
        tokens.
        """
        token = r"([A-Za-z0-9_-]{22})"
        asked = "state|answers|begin|rows|note|done|withdraw"
        return tornado.web.Application(
            [
                (r"/static/([a-z_]+\.[a-z]+)", Static),
                (rf"/p/{token}", ParticipantPage),
                (rf"/join/{token}", Join),
                (rf"/p/{token}/({asked})", ParticipantRequest),
                (rf"/experimenter/{token}", ExperimenterPage),
                (rf"/experimenter/{token}/(state|act|export)", ExperimenterRequest),
            ],
            default_handler_class=Missing,
            log_function=lambda handler: None,
            served=self,
        )

    async def _serve(self) -> None:
        server = tornado.httpserver.HTTPServer(
            self.application(),
            ssl_options=self.tls,
            max_body_size=LARGEST_BODY,
            max_header_size=16_000,
            idle_connection_timeout=120.0,
            body_timeout=30.0,
        )
        sockets = tornado.netutil.bind_sockets(self.port, self.address)
        self.port = sockets[0].getsockname()[1]
        hosts = (self.address, *self.names, *(LOOPBACK if self.address in LOOPBACK else ()))
        self.hosts = {
            f"[{host}]:{self.port}" if ":" in host else f"{host}:{self.port}" for host in hosts
        }
        if self.port == (443 if self.tls else 80):  # browsers leave the usual port out
            self.hosts |= {host.rpartition(":")[0] for host in self.hosts}
        server.add_sockets(sockets)
        self.loop, self.ending = asyncio.get_running_loop(), asyncio.Event()
        self.started.set()
        await self.ending.wait()
        server.stop()
        await server.close_all_connections()

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as error:  # told to who started it
            self.fault = error
            self.started.set()

    def __enter__(self) -> Self:
        """Begin to serve; one server per study."""
        for code in self.present():
            check_writable(self.plan.folder / code)
        self.hold = hold(self.plan.folder)
        if self.hold is None:
            raise ValueError(
                f"{self.plan.folder} is being served already, by another process or notebook"
            )
        prepare(self.plan)
        self.holder("")
        self.thread = threading.Thread(target=self._run, name="live study", daemon=True)
        self.thread.start()
        self.started.wait()
        if self.fault is not None:
            os.close(self.hold)
            raise ValueError(
                f"cannot serve on {self.address}, port {self.port}: {self.fault}"
            ) from self.fault
        return self

    def wait(self) -> None:
        """Return when interrupted."""
        try:
            while self.thread is not None and self.thread.is_alive():
                self.thread.join(1.0)
        except KeyboardInterrupt:
            print(
                "\nThe study is no longer served; what was acknowledged is on the disk.", flush=True
            )

    def __exit__(self, *_: object) -> None:
        """End the server."""
        self.loop.call_soon_threadsafe(self.ending.set)
        assert self.thread is not None
        self.thread.join(10.0)
        os.close(self.hold)


class Missing(Base):
    """Every other address."""

    def prepare(self) -> None:
        """Answer that there is no such page."""
        super().prepare()
        raise tornado.web.HTTPError(404)

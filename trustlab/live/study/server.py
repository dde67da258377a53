"""
The server of a live study, on tornado: a participant's pages, the drives over a WebSocket, and the
experimenter's page.

A link is a token of 128 bits; who has it is that participant. Pages change by what is appended to
the participant's events, one request of a participant after another; nothing is acknowledged before
it is on the disk.
"""

from __future__ import annotations

import asyncio
import json
import re
import resource
import threading
from collections import defaultdict
from collections.abc import Awaitable, Container
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from html import escape
from pathlib import Path
from typing import Any, Self
from urllib.parse import urlsplit

from trustlab.live.log import BusyError, LogError
from trustlab.live.study.pages import AnswerError
from trustlab.live.study.participant import Participant, RefusedError
from trustlab.live.study.plan import (
    EXPERIMENTER,
    JOIN,
    DeletedError,
    LiveStudy,
    drive_of,
    is_deleted,
    read_tokens,
)
from trustlab.live.task import prepare
from trustlab.live.trial import made_by
from trustlab.models.checks import flag, shown, whole_number
from trustlab.models.extras import extra

with extra("live"):
    import tornado.httpserver
    import tornado.log
    import tornado.netutil
    import tornado.web
    import tornado.websocket

STATIC = Path(__file__).parents[1] / "static"
TYPES = {
    ".js": "text/javascript",
    ".css": "text/css",
    ".html": "text/html",
    ".svg": "image/svg+xml",
}
HOME = "127.0.0.1"
"""Only this machine is answered: a proxy on it ends TLS for others."""

LARGEST_BODY = 100_000
"""Bytes of a request or message."""

MOST_CONNECTIONS = 1000
"""Connections in all; from elsewhere all come by the proxy."""

WRITERS = 64
"""Requests that may wait for the disk at once: a slow one holds up its own participant alone."""

HEADER_TIME = 10.0
"""How long the head of a request may take [s]."""

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; "
    "img-src 'self' data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
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


class Base(tornado.web.RequestHandler):
    """
    What every request goes through: host, origin, kind, and whose link it is (`who`) are checked
    before anything else. That of nobody allowed is as if the page did not exist.
    """

    def initialize(self, allowed: Container[str] | None, name: str = "") -> None:
        """Keep whose links lead here, and the file of a page."""
        self.allowed, self.name = allowed, name

    def set_default_headers(self) -> None:
        """Set the headers that all answers have, errors too."""
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        """Refuse what does not come from the study's own pages."""
        server, headers = self.server, self.request.headers
        if self.request.host not in server.hosts:  # another name for this address: DNS rebinding
            raise tornado.web.HTTPError(421)
        post = self.request.method == "POST"
        socket = headers.get("Upgrade", "").lower() == "websocket"
        origins = (f"http://{self.request.host}", server.url)
        if (socket or post) and headers.get("Origin") not in origins:
            raise tornado.web.HTTPError(403)
        if post and headers.get("Content-Type", "").partition(";")[0] != "application/json":
            raise tornado.web.HTTPError(415)
        if self.allowed is not None:
            self.who = server.holder(self.path_args[0])
            if self.who not in self.allowed:
                raise tornado.web.HTTPError(404)

    @property
    def server(self) -> StudyServer:
        """The server."""
        return self.settings["server"]

    def body(self) -> dict:
        """Return the object in JSON that was sent."""
        try:
            return parsed(self.request.body)
        except ValueError:
            raise tornado.web.HTTPError(400) from None

    def page(self, name: str) -> None:
        """Answer with a file of this package."""
        content = self.server.files.get(name)
        if content is None:
            raise tornado.web.HTTPError(404)
        self.set_header("Content-Type", f"{TYPES[Path(name).suffix]}; charset=utf-8")
        self.write(content)

    async def reply(self, work: Awaitable[dict]) -> None:
        """Answer with what work returns, or with why it cannot be done."""
        try:
            self.write(await work)
        except OSError:
            self.set_status(507)
            self.finish({"error": f"nothing can be saved: {self.server.disk}"})
        except AnswerError as error:
            self.set_status(error.status)
            self.finish({"error": str(error)})
        except DeletedError:
            raise tornado.web.HTTPError(404) from None

    def write_error(self, status_code: int, **_: Any) -> None:
        """
        Answer with nothing about the server: the number of the error, or a page for who opened a
        link that leads nowhere.
        """
        accepted = self.request.headers.get("Accept", "")
        if status_code == 404 and self.request.method == "GET" and "text/html" in accepted:
            self.page("missing.html")
            self.finish()
        else:
            self.finish({"error": status_code})

    def log_exception(self, kind: Any, value: Any, traceback: Any) -> None:
        """
        Log a mistake of ours, each once, without the address of the request, which is somebody's
        link.
        """
        # A request is cancelled where the server stops, and its page is gone.
        if isinstance(value, tornado.web.HTTPError | asyncio.CancelledError):
            return
        mistakes = self.server.mistakes
        if repr(value) not in mistakes:
            about = (kind, value, traceback)
            tornado.log.app_log.error("a request could not be answered", exc_info=about)
        mistakes.append(repr(value))


def parsed(text: str | bytes) -> dict:
    """Return an object in JSON without NaN and infinities; a ValueError says that it is none."""

    def refuse(constant: str) -> None:
        raise ValueError(constant)

    try:
        body = json.loads(text, parse_constant=refuse)
    except RecursionError:
        raise ValueError("too deep") from None
    if not isinstance(body, dict):
        raise ValueError("no object")
    return body


class Frame(Base):
    """
    The page that a link opens, which its script fills; scripts and style sheet are known by name
    when the server starts, and no others.
    """

    def get(self, token: str) -> None:
        """Answer with the page, or where none belongs to the address, the file called so."""
        self.page(self.name or token)


class Join(Frame):
    """
    The link by which anybody takes the next free place: by a button, since programs that look at
    links take none; a cookie leads back to it.
    """

    def get(self, token: str) -> None:
        """Answer with the page that asks, or lead to the place that was taken."""
        if place := self.place():
            self.redirect(f"/p/{place}")
        else:
            super().get(token)

    async def post(self, token: str) -> None:
        """Take the next free place."""
        await self.reply(self._place())

    def place(self) -> str:
        """Return the place that this browser has taken already, "" for none."""
        place = self.get_cookie("place", "")
        return place if self.server.holder(place) in self.server.plan.orders else ""

    async def _place(self) -> dict:
        place = self.place() or await self.server.free_place()
        self.set_cookie(
            "place",
            place,
            expires_days=90,
            httponly=True,
            samesite="Strict",
            secure=self.server.url.startswith("https:"),
            path="/join",
        )
        return {"link": f"/p/{place}"}


class State(Base):
    """The page of the study where a participant is."""

    async def get(self, token: str) -> None:
        """Answer with the page to show."""
        await self.reply(self.server.ask(self.who, "state", {}))


class Tell(Base):
    """What a participant tells: answers, or the wish to stop."""

    async def post(self, token: str, request: str) -> None:
        """Take it, and answer with the page to show."""
        await self.reply(self.server.ask(self.who, request, self.body()))


class Experimenter(Base):
    """Where everybody is, and what the experimenter does about it."""

    async def get(self, token: str) -> None:
        """Answer with where everybody is."""
        self.write(await asyncio.to_thread(self.server.overview))

    async def post(self, token: str) -> None:
        """Restart a drive, add a note, or end a participation; answer with where everybody is."""
        await self.reply(self._act(self.body()))

    async def _act(self, body: dict) -> dict:
        code, action = body.get("participant"), body.get("action")
        if code not in self.server.plan.present() or action not in ("restart", "note", "end"):
            raise AnswerError("there is no such participant or action")
        await self.server.ask(code, f"experimenter_{action}", body)
        return await asyncio.to_thread(self.server.overview)


class DriveSocket(tornado.websocket.WebSocketHandler, Base):
    """A drive: commands come, pictures go."""

    def check_origin(self, origin: str) -> bool:
        """Whether a page may connect: `prepare` has looked."""
        return True

    async def open(self, *_: str) -> None:
        """Begin to listen."""
        self.set_nodelay(True)

    async def on_message(self, text: str | bytes) -> None:
        """Do the commands of a message, after those before it; answer with the picture."""
        words = self.server.words
        try:
            message = parsed(text) | {"page": int(self.path_args[1])}
            answer = await self.server.ask(self.who, "drive", message)
        except OSError:
            answer = {"trouble": words["disk"]}
        except DeletedError:
            answer = {"done": True}
        except ValueError as error:
            answer = {"refused": words["stopped"].replace("{error}", str(error))}
        with suppress(tornado.websocket.WebSocketClosedError):  # the page was left meanwhile
            await self.write_message(json.dumps(answer))


class Listener(tornado.httpserver.HTTPServer):
    """A server that closes connections beyond a number."""

    most = MOST_CONNECTIONS

    def handle_stream(self, stream: Any, address: tuple) -> None:
        """Take a connection, or close it."""
        if len(self._connections) < self.most:
            super().handle_stream(stream, address)
        else:
            stream.close()


ADDRESS = re.compile(r"(http(s?)://(?:[a-z0-9.-]+|\[[0-9a-f:]+\]))(:\d+)?/?")


def address(url: str) -> str:
    """Return an address as browsers send it: in small letters, without the usual port."""
    parts = ADDRESS.fullmatch(str(url).lower())
    if parts is None:
        raise ValueError(f"url must be like https://study.example.org, got {shown(url)}")
    home, secure, port = parts.groups("")
    return home if port == (":443" if secure else ":80") else home + port


class StudyServer:
    """
    A study's server in a thread of its own: a context manager, which serves from its beginning to
    its end.

    Parameters
    ----------
    plan, port, url, enrol
        As for `LiveStudy.serve`.
    """

    def __init__(
        self,
        plan: LiveStudy,
        port: int = 0,
        *,
        url: str = "",
        enrol: bool = False,
    ):
        if plan.content["made_by"] != made_by():
            raise ValueError(
                f"the study was frozen with {plan.content['made_by']}, this is {made_by()}: its "
                "drives would not compare; go on with the version it was begun with"
            )
        self.plan, self.url = plan, address(url) if url else ""
        self.words: dict[str, str] = plan.content["words"]
        self.port = whole_number("port", port, 0, 65535)
        self.enrol = flag("enrol", enrol)
        files = (path for path in STATIC.iterdir() if path.suffix in TYPES)
        self.files = {path.name: path.read_bytes() for path in files}
        told = {"language": plan.content["language"], "words": json.dumps(self.words), **self.words}
        holes = {name: escape(text) for name, text in told.items()}
        for path in STATIC.glob("*.html"):
            self.files[path.name] = path.read_text(encoding="utf-8").format_map(holes).encode()
        self.queues: dict[str, asyncio.Lock] = defaultdict(asyncio.Lock)
        self.participants: dict[str, Participant] = {}
        self.damaged: dict[str, str] = {}  # participants who cannot go on, and why
        self.tokens: dict[str, str] = {}
        self.started = threading.Event()
        self.disk = ""
        self.mistakes = []

    def holder(self, token: str) -> str | None:
        """Return whose token this is, if it is somebody's who was not deleted."""
        # A lookup by hash: the time that it takes tells nothing of the tokens.
        name = {known: name for name, known in self.tokens.items()}.get(token)
        return name if name and not is_deleted(self.plan.folder, name) else None

    def participant(self, code: str) -> Participant:
        """Return a participant."""
        if is_deleted(self.plan.folder, code):
            if participant := self.participants.pop(code, None):
                participant.close()
            self.damaged.pop(code, None)
            raise DeletedError(f"participant {code} was deleted")
        if code in self.damaged:
            raise RefusedError(self.words["damaged"])
        return self.participants[code]

    async def ask(self, code: str, request: str, body: dict) -> Any:
        """Let a participant answer a request, in a thread, after those before it."""
        try:
            async with self.queues[code]:
                answer = await asyncio.to_thread(
                    lambda: getattr(self.participant(code), request)(body)
                )
        except OSError as error:
            self.disk_said(error.strerror or str(error))
            raise
        if request != "state":  # which need not write
            self.disk_said("")
        return answer

    async def free_place(self) -> str:
        """Take the place of the next participant whom nobody is yet, and return its token."""
        for code in self.plan.present():
            if code not in self.damaged and await self.ask(code, "enrol", {}):
                return self.tokens[code]
        raise RefusedError(self.words["full"])

    def disk_said(self, fault: str) -> None:
        """Note why nothing can be written, "" where it can; the log gets a line for each change."""
        if bool(fault) != bool(self.disk):
            said = f"cannot be saved: {fault}" if fault else "is saved again"
            tornado.log.app_log.error("what people do %s", said)
        self.disk = fault

    def overview(self) -> dict:
        """Return what the experimenter's page shows; `trouble` is of the server itself."""
        people = []
        for code in self.plan.present():
            if code not in self.damaged:
                row = self.participant(code).overview()
                people.append(row | {"link": f"{self.base}/p/{self.tokens[code]}"})
        trouble = "".join(f"{fault}. " for fault in self.damaged.values())
        if self.disk:
            trouble += (
                f"Nothing can be saved ({self.disk}): make room on the disk of "
                f"{self.plan.folder.name}. Nothing is lost; participants' pages wait, and go on by "
                "themselves. "
            )
        if self.mistakes:
            trouble += (
                f"{len(self.mistakes)} requests could not be answered because of a mistake in the "
                "server; its terminal shows which."
            )
        return {
            "study": self.plan.folder.name,
            "rehearsal": self.plan.rehearsal,
            "deleted": len(self.plan.deleted()),
            "trouble": trouble,
            "join": f"{self.base}/join/{self.tokens[JOIN]}" if self.enrol else "",
            "people": people,
        }

    @property
    def base(self) -> str:
        """The beginning of every link."""
        return self.url or f"http://{HOME}:{self.port}"

    @property
    def hosts(self) -> set[str]:
        """The names by which a request may call this server."""
        names = {f"{HOME}:{self.port}", f"localhost:{self.port}", urlsplit(self.base).netloc}
        if self.port == 80:  # browsers leave the usual port out
            names |= {HOME, "localhost"}
        return names

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
        people: dict = {"allowed": self.plan.orders}
        lab: dict = {"allowed": (EXPERIMENTER,)}
        anybody: dict = {"allowed": (JOIN,) if self.enrol else ()}
        return tornado.web.Application(
            [
                (r"/static/([a-z_]+\.[a-z]+)", Frame, {"allowed": None}),
                (rf"/p/{token}", Frame, people | {"name": "study.html"}),
                (rf"/p/{token}/state", State, people),
                (rf"/p/{token}/(answers|withdraw)", Tell, people),
                (rf"/p/{token}/drive/(\d{{1,4}})", DriveSocket, people),
                (rf"/join/{token}", Join, anybody | {"name": "join.html"}),
                (rf"/experimenter/{token}", Frame, lab | {"name": "experimenter.html"}),
                (rf"/experimenter/{token}/(?:state|act)", Experimenter, lab),
                (r"(.*)", Base, {"allowed": ()}),
            ],
            log_function=lambda handler: None,
            websocket_max_message_size=LARGEST_BODY,
            websocket_ping_interval=20.0,  # who is gone without a word is let go
            server=self,
        )

    async def _serve(self, sockets: list[Any]) -> None:
        listener = Listener(
            self.application(),
            max_body_size=LARGEST_BODY,
            max_header_size=16_000,
            idle_connection_timeout=HEADER_TIME,
            body_timeout=30.0,
        )
        listener.most = self.most
        listener.add_sockets(sockets)
        self.loop, self.ending = asyncio.get_running_loop(), asyncio.Event()
        self.loop.set_default_executor(ThreadPoolExecutor(WRITERS))
        self.started.set()
        await self.ending.wait()
        listener.stop()
        await listener.close_all_connections()

    def __enter__(self) -> Self:
        """Begin to serve; one server per study."""
        with ExitStack() as files:
            self._open(files)
            try:
                sockets = tornado.netutil.bind_sockets(self.port, HOME)
            except OSError as error:
                raise ValueError(
                    f"{self.plan.folder} cannot be served on port {self.port}: {error}"
                ) from error
            self.held = files.pop_all()
        self.port = sockets[0].getsockname()[1]
        self.thread = threading.Thread(
            target=asyncio.run, args=(self._serve(sockets),), name="live study", daemon=True
        )
        self.thread.start()
        if not self.started.wait(10.0):
            self.held.close()
            raise ValueError("the server did not start within 10 s; a traceback says why")
        return self

    def _open(self, files: ExitStack) -> None:
        """Open all that is served, and refuse what cannot be."""
        self.tokens = read_tokens(self.plan.folder)
        # Everybody has two logs, and the process some files of its own.
        own = 2 * len(self.plan.orders) + 50
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        soft = max(soft, min(own + MOST_CONNECTIONS, hard))
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        self.most = min(MOST_CONNECTIONS, max(soft - own, 10))
        for code in self.plan.present():
            try:
                self.participants[code] = Participant(self.plan, code, self.plan.rehearsal)
            except BusyError:
                raise ValueError(
                    f"{self.plan.folder} is being served already, by another process or notebook"
                ) from None
            except LogError as error:  # the others go on
                self.damaged[code] = str(error)
                tornado.log.app_log.error("%s", error)
            else:
                files.callback(self.participants[code].close)
        prepare(self.plan.task, drive_of(self.plan.content, "training"))

    def wait(self) -> None:
        """Return when interrupted."""
        try:
            while self.thread.is_alive():
                self.thread.join(1.0)
        except KeyboardInterrupt:
            print(
                "\nThe study is no longer served; what was acknowledged is on the disk.", flush=True
            )

    def __exit__(self, *_: object) -> None:
        """End the server."""
        self.loop.call_soon_threadsafe(self.ending.set)
        self.thread.join(10.0)
        self.held.close()

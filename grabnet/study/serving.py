"""The server of a study: its page and videos, lists for raters, and their answers, stored before they are confirmed.

Runs on aiohttp, whose event loop serves hundreds of raters on one core, and which answers requests for parts of a video
(Safari asks for nothing else).
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import ssl
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from aiohttp import web

from grabnet.cli.checks import Count, Range, in_range
from grabnet.cli.ends import say
from grabnet.errors import UserError
from grabnet.io.files import existing
from grabnet.study.key import ANSWERS, PRIVATE, SITE, StudyKey
from grabnet.study.records import RecordError, check_record, decode
from grabnet.study.store import AnswerStore, ConflictError

# Sessions and addresses that are kept in mind at most.
_REMEMBERED = 20_000
_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; media-src 'self'; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
}


@dataclass(frozen=True)
class ServeConfig:
    """The values of `configs/study/serve.yaml`, which explains them.

    Raises:
        UserError: a value out of range.
    """

    export: str
    host: str
    port: Annotated[int, Range(0, 65_535)]
    max_bytes: Annotated[int, Range(1000, 100_000_000)]
    posts_per_minute: Count
    max_records: Count
    certificate: str | None
    private_key: str | None
    quiet: bool = False  # for the command

    def __post_init__(self):
        in_range(self)
        if (self.certificate is None) != (self.private_key is None):
            raise UserError("certificate and private_key belong together; give both or neither.")


class StudyServer:
    """Answers the requests of raters' browsers.

    Args:
        key: of the study.
        site: folder to serve: the files that are in it now, and no others.
        store: of answers.
        config: limits.
    """

    def __init__(self, key: StudyKey, site: Path, store: AnswerStore, config: ServeConfig):
        self.key, self.store, self.config = key, store, config
        self._files = {f"/{p.relative_to(site).as_posix()}": p for p in site.rglob("*") if p.is_file()}
        self._files["/"] = site / "index.html"
        self._given: OrderedDict[str, int] = OrderedDict()
        self._handed = [0] * len(key.lists)
        self._posts: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self._waiting: list[tuple[dict[str, Any], asyncio.Future[Exception | None]]] = []
        self._writing: asyncio.Task[None] | None = None

    def application(self) -> web.Application:
        """The application that aiohttp runs."""
        app = web.Application(middlewares=[self._guarded], client_max_size=self.config.max_bytes)
        app.router.add_post("/answers", self._take)
        app.router.add_post("/assignment", self._assign)
        app.router.add_get("/{path:.*}", self._serve)
        return app

    @web.middleware
    async def _guarded(
        self, request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        """Limit, and give every answer, refusals too, the same headers."""
        try:
            if request.method == "POST" and not self._may_post(request.remote or ""):
                raise web.HTTPTooManyRequests(text="too many requests; wait a minute")
            response = await handler(request)
        except web.HTTPException as refusal:
            response = web.json_response({"error": refusal.text or refusal.reason}, status=refusal.status)
        response.headers.update(_HEADERS)
        return response

    async def _serve(self, request: web.Request) -> web.StreamResponse:
        path = self._files.get(request.path)  # as it was found at the start: no path leads outside of it
        if path is None:
            raise web.HTTPNotFound
        lasting = path.suffix in (".mp4", ".jpg")  # named by what they show
        keep = "public, max-age=604800, immutable" if lasting else "no-cache"
        return web.FileResponse(path, headers={"Cache-Control": keep})

    async def _assign(self, request: web.Request) -> web.StreamResponse:
        """Give the list that the fewest raters answered or were given, the same again to the same session."""
        value = await self._json(request)
        if not isinstance(value, dict) or value.get("study") != self.key.study:
            raise web.HTTPBadRequest(text="it is of another study")
        session = value.get("session")
        if not isinstance(session, str) or len(session) != 32:
            raise web.HTTPBadRequest(text="session must be 32 hexadecimal digits")
        if session not in self._given:
            number = min(range(len(self._handed)), key=lambda k: (self._handed[k] + self.store.lists.get(k, 0), k))
            self._handed[number] += 1
            self._given[session] = number
            if len(self._given) > _REMEMBERED:
                self._handed[self._given.popitem(last=False)[1]] -= 1
        return web.json_response({"list": self._given[session]})

    async def _take(self, request: web.Request) -> web.StreamResponse:
        """Store a record; it is confirmed once the disk has it."""
        record = await self._json(request)
        try:
            check_record(record, self.key)
        except RecordError as wrong:
            raise web.HTTPBadRequest(text=str(wrong)) from None
        if len(self.store) >= self.config.max_records:
            raise web.HTTPServiceUnavailable(text="the study has all the answers that it takes")
        stored = asyncio.get_running_loop().create_future()
        self._waiting.append((record, stored))
        if self._writing is None or self._writing.done():
            self._writing = asyncio.create_task(self._write())
        outcome = await stored
        if isinstance(outcome, ConflictError):
            raise web.HTTPConflict(text="this session has sent other answers before")
        if outcome is not None:
            say(f"Answers cannot be stored: {outcome}")
            raise web.HTTPInsufficientStorage(text="the answers could not be stored")
        number = self._given.pop(record["session"], None)
        if number is not None:
            self._handed[number] -= 1  # from now on it counts as answered
        return web.json_response({"stored": record["session"]})

    async def _write(self) -> None:
        """Store what waits, all that came meanwhile with one wait for the disk."""
        while self._waiting:
            batch, self._waiting = self._waiting, []
            outcomes = await asyncio.to_thread(self.store.add, [record for record, _ in batch])
            for (_, stored), outcome in zip(batch, outcomes, strict=True):
                if not stored.cancelled():
                    stored.set_result(outcome)

    async def _json(self, request: web.Request) -> Any:
        if request.content_type != "application/json":
            raise web.HTTPUnsupportedMediaType(text="it must be application/json")
        try:
            return decode(await request.read())
        except RecordError as wrong:
            raise web.HTTPBadRequest(text=str(wrong)) from None

    def _may_post(self, address: str) -> bool:
        """Whether an address has posted less than it may: as many at once as in a minute, then evenly."""
        most, now = float(self.config.posts_per_minute), time.monotonic()
        left, before = self._posts.pop(address, (most, now))
        left = min(most, left + (now - before) * most / 60)
        self._posts[address] = (left - 1 if left >= 1 else left, now)
        if len(self._posts) > _REMEMBERED:
            self._posts.popitem(last=False)
        return left >= 1


def run(config: ServeConfig) -> int:
    """Serve an export until interrupted.

    Raises:
        UserError: no export, a port that is taken, or a certificate that cannot be read.
    """
    folder = Path(config.export).expanduser()
    key = StudyKey.read(folder)
    site = existing(folder / SITE, "Served folder")
    existing(site / "index.html", "Page")
    with AnswerStore(folder / PRIVATE / ANSWERS) as store:
        print(f"{len(store)} raters' answers are stored in {folder / PRIVATE / ANSWERS}", flush=True)
        application = StudyServer(key, site, store, config).application()
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(_serve(application, config))
    return 0


async def _serve(application: web.Application, config: ServeConfig) -> None:
    runner = web.AppRunner(application, access_log=None)
    await runner.setup()
    secure = _secured(config)
    try:
        place = web.TCPSite(runner, config.host, config.port, ssl_context=secure, backlog=1024)
        await place.start()
    except OSError as error:
        await runner.cleanup()
        raise UserError(
            f"{config.host}:{config.port} cannot be served at ({error.strerror}); choose another."
        ) from None
    port = runner.addresses[0][1]
    print(f"Serving at {'https' if secure else 'http'}://{config.host}:{port}/ until Ctrl-C", flush=True)
    ended = asyncio.Event()
    for sign in (signal.SIGINT, signal.SIGTERM):
        with contextlib.suppress(NotImplementedError):  # Windows, which interrupts instead
            asyncio.get_running_loop().add_signal_handler(sign, ended.set)
    try:
        await ended.wait()
    finally:
        await runner.cleanup()


def _secured(config: ServeConfig) -> ssl.SSLContext | None:
    if config.certificate is None:
        return None
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(Path(config.certificate).expanduser(), Path(config.private_key or "").expanduser())
    except (OSError, ssl.SSLError) as error:
        raise UserError(f"{config.certificate} or {config.private_key} cannot be used ({error}).") from None
    return context

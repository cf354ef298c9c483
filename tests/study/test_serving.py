"""The server, as a process of its own: what it gives, what it refuses, and that it loses nothing."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
import signal
import socket
import ssl
import stat
import subprocess

import aiohttp
import pytest

from grabnet.errors import UserError
from grabnet.study.key import StudyKey
from grabnet.study.records import RecordError, check_record, decode
from grabnet.study.serving import ServeConfig
from grabnet.study.store import AnswerStore, ConflictError
from tests.study.conftest import made_key, record_of, served

RATERS = 200


def stored(folder) -> list[dict]:
    return [json.loads(line) for line in (folder / "private/answers.jsonl").read_text().splitlines()]


def changed(record: dict, **values) -> dict:
    return record | values


async def post(session, address: str, data: bytes, **headers: str) -> tuple[int, dict]:
    headers = {"Content-Type": "application/json"} | headers
    async with session.post(address, data=data, headers=headers) as response:
        assert "default-src 'none'" in response.headers["Content-Security-Policy"]
        assert response.headers["X-Content-Type-Options"] == "nosniff"
        return response.status, await response.json()


def test_two_hundred_raters_at_once_then_every_kind_of_attack(unfilmed):
    key = StudyKey.read(unfilmed)

    async def rate(session, address: str, rater: int) -> int:
        """A whole participation: page, list, videos, answers, sent twice as after a lost reply."""
        for path in ("/", "/study.js", "/jspsych/jspsych.js"):
            async with session.get(address + path) as response:
                assert response.status == 200 and await response.read()
        asked = json.dumps({"study": key.study, "session": f"{rater:032x}"}).encode()
        status, given = await post(session, f"{address}/assignment", asked)
        again = await post(session, f"{address}/assignment", asked)
        assert (status, given) == again and status == 200
        for (name,) in key.lists[given["list"]]:
            async with session.get(f"{address}/videos/{name}.mp4", headers={"Range": "bytes=0-3"}) as response:
                assert response.status == 206 and await response.text() == name[:4]
                assert "immutable" in response.headers["Cache-Control"]
        data = json.dumps(record_of(key, given["list"], rater)).encode()
        for _ in range(2):
            assert await post(session, f"{address}/answers", data) == (200, {"stored": f"{rater:032x}"})
        return given["list"]

    async def attack(session, address: str) -> None:
        good = record_of(key, 0, 10**6)
        answer = good["answers"][0]
        bad = [
            b"", b"x", b"[]", b"null", b"{}", b'"<script>alert(1)</script>"', b"\xff\xfe", b"[" * 50_000,
            b'{"study": NaN}', json.dumps(good).encode().replace(b'"list": 0', b'"list": 0, "list": 1'),
        ]  # fmt: skip
        wrong = [
            changed(good, study="<script>"), changed(good, study="f" * 16), changed(good, study=None),
            changed(good, session="../../etc/passwd"), changed(good, session="A" * 32), changed(good, session=7),
            changed(good, list=-1), changed(good, list=10**30), changed(good, list=True), changed(good, list="0"),
            changed(good, list=1), changed(good, extra=1), {k: v for k, v in good.items() if k != "platform"},
            changed(good, platform={"PROLIFIC_PID": "<script>alert(1)</script>"}), changed(good, platform=[]),
            changed(good, platform={"email": "a"}), changed(good, platform={"STUDY_ID": 3}),
            changed(good, platform={"SESSION_ID": "a" * 65}), changed(good, answers={}), changed(good, answers=[]),
            changed(good, answers=good["answers"][1:]), changed(good, answers=[*good["answers"], answer]),
            changed(good, answers=[answer] * len(good["answers"])),
        ]  # fmt: skip
        for field, values in {
            "videos": ["../key", ["../private/key"], [answer["videos"][0]] * 2, [], [1], [["a"]], None],
            "answer": [0, 6, -1, 2.0, "4", "<b>", True, None, [4], 10**30],
            "seconds": [-1, "1", None, True, 1e9, [1]],
        }.items():
            wrong += [changed(good, answers=[{**answer, field: v}, *good["answers"][1:]]) for v in values]
        before = (unfilmed / "private/answers.jsonl").read_bytes()
        for data in [*bad, *(json.dumps(record).encode() for record in wrong)]:
            status, said = await post(session, f"{address}/answers", data)
            assert status == 400 and "script" not in said["error"] and ".." not in said["error"], data[:200]
        status, _ = await post(session, f"{address}/answers", json.dumps(changed(good, x="y" * 300_000)).encode())
        assert status == 413
        data = json.dumps(record_of(key, 0, 10**6)).encode()
        assert (await post(session, f"{address}/answers", data, **{"Content-Type": "text/plain"}))[0] == 415
        other = json.dumps(record_of(key, stored(unfilmed)[0]["list"], int(stored(unfilmed)[0]["session"], 16), 5))
        assert (await post(session, f"{address}/answers", other.encode()))[0] == 409
        for value in (
            [],
            {"study": key.study},
            {"study": "x", "session": "0" * 32},
            {"study": key.study, "session": 1},
        ):
            assert (await post(session, f"{address}/assignment", json.dumps(value).encode()))[0] == 400
        for method, path in [("PUT", "/answers"), ("DELETE", "/"), ("GET", "/answers"), ("GET", "/videos"),
                             ("GET", "/videos/"), ("GET", "/private/key.json"), ("GET", "/nothing")]:  # fmt: skip
            async with session.request(method, address + path) as response:
                assert response.status in (404, 405) and "default-src" in response.headers["Content-Security-Policy"]
        assert (unfilmed / "private/answers.jsonl").read_bytes() == before

    async def everybody(address: str) -> list[int]:
        connector = aiohttp.TCPConnector(limit=0)
        async with aiohttp.ClientSession(connector=connector) as session:
            lists = await asyncio.gather(*(rate(session, address, k) for k in range(RATERS)))
            await attack(session, address)
            return lists

    with served(unfilmed, "posts_per_minute=100000") as (address, _):
        lists = asyncio.run(everybody(address))
        host, port = address.removeprefix("http://").split(":")
        outside = ["/../private/key.json", "/videos/../../private/key.json", "/%2e%2e/private/key.json",
                   "/videos/%2e%2e%2f%2e%2e%2fprivate%2fkey.json", "//etc/passwd", "/..\\private/key.json"]  # fmt: skip
        for path in outside:
            with socket.create_connection((host, int(port))) as raw:  # as no client writes it
                raw.sendall(f"GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n".encode())
                reply = b"".join(iter(lambda raw=raw: raw.recv(65536), b""))
            assert reply.split()[1] in (b"404", b"400") and b"condition" not in reply and b"root:" not in reply
    records = stored(unfilmed)
    assert sorted(int(r["session"], 16) for r in records) == list(range(RATERS))
    shares = [lists.count(k) for k in range(len(key.lists))]
    assert sum(shares) == RATERS and max(shares) - min(shares) <= 1
    assert stat.S_IMODE((unfilmed / "private/answers.jsonl").stat().st_mode) == 0o600


def test_nothing_acknowledged_is_lost_when_the_server_is_killed(unfilmed):
    key = StudyKey.read(unfilmed)
    acknowledged: set[str] = set()

    async def rate(session, address: str, rater: int, process) -> None:
        data = json.dumps(record_of(key, rater % len(key.lists), rater)).encode()
        try:
            status, said = await post(session, f"{address}/answers", data)
        except (aiohttp.ClientError, OSError):
            return
        assert status == 200
        acknowledged.add(said["stored"])
        if len(acknowledged) == 40:
            os.kill(process.pid, signal.SIGKILL)

    async def everybody(address: str, process) -> None:
        limit = asyncio.Semaphore(8)  # so that the kill comes in the midst of it

        async def in_turn(session, rater):
            async with limit:
                await rate(session, address, rater, process)

        async with aiohttp.ClientSession() as session:
            await asyncio.gather(*(in_turn(session, k) for k in range(100)))

    with served(unfilmed) as (address, process):
        asyncio.run(everybody(address, process))
        assert process.wait(30) == -signal.SIGKILL
    assert 40 <= len(acknowledged) < 100
    path = unfilmed / "private/answers.jsonl"
    assert acknowledged <= {record["session"] for record in stored(unfilmed)}
    # A line cut off in the midst does no harm to what comes after it.
    with path.open("ab") as file:
        file.write(b'{"study": "cut o')
    with AnswerStore(path) as store:
        before = len(store)
        assert acknowledged <= {record["session"] for record in map(json.loads, path.read_bytes().splitlines()[:-1])}
        assert store.add([record_of(key, 1, 5000)]) == [None]
        assert len(store) == before + 1
        with pytest.raises(UserError, match="in use by another server"):
            AnswerStore(path)
    assert json.loads(path.read_bytes().splitlines()[-1])["session"] == f"{5000:032x}"


def test_the_rate_of_posts_and_the_number_of_records_are_limited(unfilmed):
    key = StudyKey.read(unfilmed)

    async def rate(address: str) -> list[int]:
        async with aiohttp.ClientSession() as session:
            send = [json.dumps(record_of(key, 0, k)).encode() for k in range(6)]
            return [(await post(session, f"{address}/answers", data))[0] for data in send]

    with served(unfilmed, "posts_per_minute=5", "max_records=3") as (address, _):
        assert asyncio.run(rate(address)) == [200, 200, 200, 503, 503, 429]
    assert len(stored(unfilmed)) == 3


def test_a_full_disk_leaves_what_was_there_whole(unfilmed, monkeypatch):
    key, path = StudyKey.read(unfilmed), unfilmed / "private/answers.jsonl"
    with AnswerStore(path) as store:
        assert store.add([record_of(key, 0, 1)]) == [None]
        before, write = path.read_bytes(), os.write

        def full(file: int, data: bytes) -> int:
            if len(data) < 60:
                raise OSError(28, "No space left on device")
            return write(file, data[:50])

        monkeypatch.setattr(os, "write", full)
        (failed, known) = store.add([record_of(key, 1, 2), record_of(key, 0, 1)])
        monkeypatch.undo()
        assert isinstance(failed, OSError) and known is None and path.read_bytes() == before
        assert store.add([record_of(key, 1, 2)]) == [None] and len(stored(unfilmed)) == 2
        assert isinstance(store.add([record_of(key, 1, 2, answer=1)])[0], ConflictError)


def test_mistakes_of_the_command_line_are_one_sentence(unfilmed, tmp_path):
    for wrong in ("certificate=a", "export=nowhere"):
        with pytest.raises(AssertionError, match=r"^error: [^\n]+\n$"), served(unfilmed, wrong):
            pass
    with pytest.raises(UserError, match="max_bytes is 3"):
        ServeConfig(str(tmp_path), "127.0.0.1", 0, 3, 5, 5, None, None)


@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl is installed")
def test_with_a_certificate_everything_is_encrypted(unfilmed, tmp_path):
    key = StudyKey.read(unfilmed)
    certificate, private = tmp_path / "own.pem", tmp_path / "own.key"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
         "-subj", "/CN=study", "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", private, "-out", certificate],
        check=True, capture_output=True,
    )  # fmt: skip
    trusting = ssl.create_default_context(cafile=str(certificate))

    async def send(address: str) -> tuple[int, dict]:
        async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(ssl=trusting)) as session:
            return await post(session, f"{address}/answers", json.dumps(record_of(key, 0, 1)).encode())

    async def refused(address: str) -> None:
        async with aiohttp.ClientSession() as session, session.get(address):
            pass

    with served(unfilmed, f"certificate={certificate}", f"private_key={private}") as (address, _):
        assert address.startswith("https://")
        assert asyncio.run(send(address)) == (200, {"stored": f"{1:032x}"})
        with pytest.raises(aiohttp.ClientConnectorCertificateError):  # by who does not know this certificate
            asyncio.run(refused(address))
        with pytest.raises(aiohttp.ClientError):  # not encrypted
            asyncio.run(refused(address.replace("https", "http")))
    assert len(stored(unfilmed)) == 1
    with pytest.raises(AssertionError, match=r"^error: [^\n]+own.pem[^\n]+\n$"):
        private.write_text("no key")
        with served(unfilmed, f"certificate={certificate}", f"private_key={private}"):
            pass


@pytest.mark.parametrize("text", ["-Infinity", '{"a": 1, "a": 2}', "\x00", '"\ud800'])
def test_json_is_read_strictly(text):
    with pytest.raises(RecordError):
        decode(text)


def test_a_paired_record_names_both_sides_once():
    key = made_key("paired")
    record = record_of(key, 2, 1, answer=2)
    check_record(record, key)
    record["answers"] = [{**answer, "videos": answer["videos"][::-1]} for answer in record["answers"]]
    check_record(record, key)
    for wrong in (
        record["answers"][0] | {"answer": 3},
        record["answers"][0] | {"videos": record["answers"][0]["videos"][:1]},
    ):
        with pytest.raises(RecordError):
            check_record(record | {"answers": [wrong, *record["answers"][1:]]}, key)

"""A bucket over loopback that speaks as much of S3 as reading takes: list, head, get of a range."""

from __future__ import annotations

import hashlib
import re
import threading
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit
from xml.sax.saxutils import escape

import s3fs

OPEN, CLOSED = "bucket", "closed"
_PAGE = 3


@dataclass
class Bucket:
    """The objects by key, and the requests that were made."""

    objects: dict[str, bytes] = field(default_factory=dict)
    requests: list[str] = field(default_factory=list)

    def fill(self, folder: Path, prefix: str) -> None:
        """Copy a folder's files, as ``aws s3 sync`` does."""
        for path in folder.rglob("*"):
            if path.is_file():
                self.objects[f"{prefix}/{path.relative_to(folder)}"] = path.read_bytes()


def _listing(bucket: Bucket, query: dict[str, str]) -> str:
    """Return a page of keys; continued pages are asked for by the last key of the one before."""
    prefix, delimiter = query.get("prefix", ""), query.get("delimiter")
    after = query.get("continuation-token", "")
    found: dict[str, str] = {}
    for key, content in sorted(bucket.objects.items()):
        if not key.startswith(prefix):
            continue
        head = key[len(prefix) :].partition(delimiter or "\0")[0]
        if delimiter and key[len(prefix) + len(head) :]:
            name = f"{prefix}{head}{delimiter}"
            found[name] = f"<CommonPrefixes><Prefix>{escape(name)}</Prefix></CommonPrefixes>"
        else:
            found[key] = (
                f"<Contents><Key>{escape(key)}</Key><Size>{len(content)}</Size>"
                f"<ETag>{_etag(content)}</ETag>"
                "<LastModified>2026-01-05T12:00:00.000Z</LastModified></Contents>"
            )
    names = [name for name in sorted(found) if name > after]
    shown = names[:_PAGE]
    more = len(names) > len(shown)
    token = f"<NextContinuationToken>{escape(shown[-1])}</NextContinuationToken>" if more else ""
    return (
        f"<ListBucketResult><Name>{OPEN}</Name><KeyCount>{len(shown)}</KeyCount>"
        f"<IsTruncated>{str(more).lower()}</IsTruncated>{token}"
        + "".join(found[name] for name in shown)
        + "</ListBucketResult>"
    )


@cache
def _etag(content: bytes) -> str:
    return f'"{hashlib.md5(content).hexdigest()}"'


def _handler(bucket: Bucket) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def log_message(self, *arguments: object) -> None:
            pass

        def do_HEAD(self) -> None:
            self.do_GET()

        def do_GET(self) -> None:
            url = urlsplit(self.path)
            name, _, key = unquote(url.path).lstrip("/").partition("/")
            bucket.requests.append(f"{self.command} {name}/{key} {self.headers.get('Range', '')}")
            if name == CLOSED:
                self.refuse(403, "AccessDenied")
            elif name != OPEN:
                self.refuse(404, "NoSuchBucket")
            elif not key:
                query = {name: values[0] for name, values in parse_qs(url.query).items()}
                self.answer(200, _listing(bucket, query).encode(), "application/xml")
            elif key not in bucket.objects:
                self.refuse(404, "NoSuchKey")
            else:
                self.give(bucket.objects[key])

        def give(self, content: bytes) -> None:
            found = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
            if self.headers.get("If-Match", _etag(content)) != _etag(content):
                self.refuse(412, "PreconditionFailed")
            elif found:
                first, last = int(found[1]), min(int(found[2]), len(content) - 1)
                span = {"Content-Range": f"bytes {first}-{last}/{len(content)}"}
                self.answer(206, content[first : last + 1], "binary/octet-stream", content, span)
            else:
                self.answer(200, content, "binary/octet-stream", content)

        def refuse(self, status: int, code: str) -> None:
            body = f"<Error><Code>{code}</Code><Message>{code} it is</Message></Error>"
            self.answer(status, body.encode(), "application/xml")

        def answer(self, status, body, kind, whole=None, headers=None) -> None:
            self.send_response(status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            if whole is not None:
                self.send_header("ETag", _etag(whole))
                self.send_header("Last-Modified", "Mon, 05 Jan 2026 12:00:00 GMT")
            for name, value in (headers or {}).items():
                self.send_header(name, value)
            self.end_headers()
            if self.command != "HEAD":
                self.wfile.write(body)

    return Handler


@contextmanager
def served(monkeypatch):
    """Serve a bucket and let ``s3://`` URLs lead to it, in this process and its children."""
    bucket = Bucket()
    server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(bucket))
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{server.server_port}")
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY", "AWS_DEFAULT_REGION"):
        monkeypatch.setenv(name, "test")
    for name in ("AWS_CONFIG_FILE", "AWS_SHARED_CREDENTIALS_FILE"):
        monkeypatch.setenv(name, "/dev/null")
    s3fs.S3FileSystem.clear_instance_cache()
    try:
        yield bucket
    finally:
        server.shutdown()
        server.server_close()
        s3fs.S3FileSystem.clear_instance_cache()

"""A Hub in miniature: a real HTTP server that keeps repositories and speaks the calls of huggingface_hub that are used.

It knows one token. Files that git-lfs would keep are uploaded by its protocol, since the Hub's newer one (Xet) needs a
store of chunks behind it; ``HF_HUB_DISABLE_XET`` makes the library use the older.
"""

import base64
import hashlib
import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import unquote, urlsplit

TOKEN = "hf_of_the_tests"
_LFS = ".safetensors"


@dataclass
class Repository:
    """Commits by their names, each with all of its files, and branches."""

    private: bool = False
    commits: dict[str, dict[str, bytes]] = field(default_factory=dict)
    branches: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.commit("main", {".gitattributes": b"*.safetensors filter=lfs\n"})

    def commit(self, branch: str, files: dict[str, bytes]) -> str:
        name = hashlib.sha1(f"{len(self.commits)} {sorted(files)}".encode()).hexdigest()
        self.commits[name] = files
        self.branches[branch] = name
        return name

    def find(self, revision: str) -> str | None:
        return self.branches.get(revision, revision if revision in self.commits else None)


class LocalHub(ThreadingHTTPServer):
    """The server; ``requests`` are what it was asked for, ``failing`` a status that it answers everything with."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.repositories: dict[str, Repository] = {}
        self.blobs: dict[str, bytes] = {}
        self.requests: list[str] = []
        self.failing = 0

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"

    def files(self, repository: str, revision: str = "main") -> dict[str, bytes]:
        kept = self.repositories[repository]
        return kept.commits[kept.find(revision) or ""]


@contextmanager
def running_hub() -> Iterator[LocalHub]:
    with LocalHub() as hub:
        thread = threading.Thread(target=hub.serve_forever, daemon=True)
        thread.start()
        try:
            yield hub
        finally:
            hub.shutdown()
            thread.join()


class _Handler(BaseHTTPRequestHandler):
    server: LocalHub
    protocol_version = "HTTP/1.1"

    def log_message(self, *_: Any) -> None: ...

    def do_GET(self) -> None:
        self._route()

    do_HEAD = do_POST = do_PUT = do_GET  # noqa: N815

    def _route(self) -> None:
        path = unquote(urlsplit(self.path).path)
        self.server.requests.append(f"{self.command} {path}")
        self._body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        if self.headers.get("Transfer-Encoding") == "chunked":
            raise NotImplementedError("bodies in chunks")
        if self.server.failing:
            return self._refuse(self.server.failing, "", "out of order")
        for pattern, answer in (
            (r"POST /api/repos/create", self._create),
            (r"POST /api/validate-yaml", self._validate),
            (r"(?:GET|HEAD) /api/models/([^/]+/[^/]+)(?:/revision/(.+))?", self._info),
            (r"GET /api/models/([^/]+/[^/]+)/tree/(.+)", self._tree),
            (r"POST /api/models/([^/]+/[^/]+)/branch/(.+)", self._branch),
            (r"POST /api/models/([^/]+/[^/]+)/preupload/(.+)", self._preupload),
            (r"POST /api/models/([^/]+/[^/]+)/commit/(.+)", self._commit),
            (r"POST /([^/]+/[^/]+)\.git/info/lfs/objects/batch", self._batch),
            (r"PUT /blobs/(\w+)", self._blob),
            (r"(?:GET|HEAD) /([^/]+/[^/]+)/resolve/([^/]+)/(.+)", self._file),
        ):
            if matched := re.fullmatch(pattern, f"{self.command} {path}"):
                return answer(*matched.groups())
        return self._refuse(404, "", f"no such call: {self.command} {path}")

    def _create(self) -> None:
        if not self._may_write():
            return
        wanted = json.loads(self._body)
        name = f"{wanted['organization']}/{wanted['name']}"
        if wanted["organization"] != "tests":
            return self._refuse(403, "", f"you may not create repositories of {wanted['organization']}")
        if name in self.server.repositories:
            return self._answer({"error": "you already have it", "url": f"{self.server.address}/{name}"}, 409)
        private = wanted.get("visibility") == "private" or bool(wanted.get("private"))
        self.server.repositories[name] = Repository(private)
        self._answer({"url": f"{self.server.address}/{name}", "name": name})

    def _validate(self) -> None:
        content = json.loads(self._body)["content"]
        good = content.startswith("---\nlicense: ") and "\n---\n" in content
        errors = [] if good else [{"message": "metadata is missing"}]
        self._answer({"errors": errors, "warnings": []}, 200 if good else 400)

    def _info(self, name: str, revision: str | None) -> None:
        if (found := self._commit_of(name, revision or "main")) is None:
            return
        siblings = [{"rfilename": path} for path in self.server.files(name, found)]
        private = self.server.repositories[name].private
        self._answer({"id": name, "modelId": name, "sha": found, "private": private, "tags": [], "siblings": siblings})

    def _tree(self, name: str, revision: str) -> None:
        if (found := self._commit_of(name, revision)) is None:
            return
        entries = []
        for path, content in self.server.files(name, found).items():
            entry: dict[str, Any] = {"type": "file", "path": path, "size": len(content), "oid": _git(content)}
            if path.endswith(_LFS):
                entry["lfs"] = {"oid": _sha(content), "size": len(content), "pointerSize": 134}
            entries.append(entry)
        self._answer(entries)

    def _branch(self, name: str, branch: str) -> None:
        if not self._may_write() or (found := self._commit_of(name, "main")) is None:
            return
        kept = self.server.repositories[name]
        if branch in kept.branches:
            return self._refuse(409, "", "the branch exists")
        kept.branches[branch] = found
        self._answer({})

    def _preupload(self, name: str, revision: str) -> None:
        if not self._may_write() or self._commit_of(name, revision) is None:
            return
        paths = [entry["path"] for entry in json.loads(self._body)["files"]]
        modes = {path: "lfs" if path.endswith(_LFS) else "regular" for path in paths}
        self._answer({"files": [{"path": p, "uploadMode": m, "shouldIgnore": False} for p, m in modes.items()]})

    def _batch(self, name: str) -> None:
        if not self._may_write():
            return
        objects = []
        for wanted in json.loads(self._body)["objects"]:
            upload = {"href": f"{self.server.address}/blobs/{wanted['oid']}"}
            actions = {} if wanted["oid"] in self.server.blobs else {"actions": {"upload": upload}}
            objects.append({**wanted, **actions})
        self._answer({"transfer": "basic", "objects": objects})

    def _blob(self, oid: str) -> None:
        if _sha(self._body) != oid:
            return self._refuse(400, "", "that is another file")
        self.server.blobs[oid] = self._body
        self._answer({})

    def _commit(self, name: str, revision: str) -> None:
        if not self._may_write() or (found := self._commit_of(name, revision)) is None:
            return
        files = dict(self.server.files(name, found))
        for line in self._body.splitlines():
            entry = json.loads(line)
            value = entry["value"]
            if entry["key"] == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif entry["key"] == "lfsFile":
                files[value["path"]] = self.server.blobs[value["oid"]]
            elif entry["key"] == "deletedFile":
                del files[value["path"]]
        made = self.server.repositories[name].commit(revision, files)
        self._answer({"success": True, "commitUrl": f"{self.server.address}/{name}/commit/{made}", "commitOid": made})

    def _file(self, name: str, revision: str, path: str) -> None:
        if (found := self._commit_of(name, revision)) is None:
            return
        content = self.server.files(name, found).get(path)
        if content is None:
            return self._refuse(404, "EntryNotFound", "no such file")
        tag = _sha(content) if path.endswith(_LFS) else _git(content)
        self._send(200, content, {"ETag": f'"{tag}"', "X-Repo-Commit": found})

    def _commit_of(self, name: str, revision: str) -> str | None:
        """Return a commit's name; answer that there is none, or none that the asker may see."""
        kept = self.server.repositories.get(name)
        if kept is None or (kept.private and not self._has_token()):
            self._refuse(404 if self._has_token() else 401, "RepoNotFound", "Repository not found")
            return None
        found = kept.find(revision)
        if found is None:
            self._refuse(404, "RevisionNotFound", f"no revision {revision}")
        return found

    def _has_token(self) -> bool:
        return self.headers.get("Authorization") == f"Bearer {TOKEN}"

    def _may_write(self) -> bool:
        if not self._has_token():
            self._refuse(401, "", "Invalid credentials in Authorization header")
        return self._has_token()

    def _answer(self, content: Any, status: int = 200) -> None:
        self._send(status, json.dumps(content).encode(), {"Content-Type": "application/json"})

    def _refuse(self, status: int, code: str, message: str) -> None:
        content = json.dumps({"error": message}).encode()
        headers = {"Content-Type": "application/json", "X-Error-Code": code, "X-Error-Message": message}
        self._send(status, content, {name: value for name, value in headers.items() if value})

    def _send(self, status: int, content: bytes, headers: dict[str, str]) -> None:
        self.send_response(status)
        for name, value in {**headers, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)


def _sha(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _git(content: bytes) -> str:
    return hashlib.sha1(b"blob %d\0" % len(content) + content).hexdigest()

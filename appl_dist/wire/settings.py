"""Where the wire is and who may use it, checked before any socket is opened."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from appl_dist.errors import UserError

_ENDPOINT = re.compile(r"(tcp|tls)/(\[[0-9A-Fa-f:]+\]|[A-Za-z0-9_.-]+):(\d{1,5})")
_LOOPBACK = ("127.", "localhost", "[::1]")


@dataclass(frozen=True)
class WireSettings:
    """Settings of one process's connection; UserError naming the field that cannot be.

    endpoint: `tcp/HOST:PORT` or `tls/HOST:PORT`. The learner listens on it (0.0.0.0 for every interface),
        everyone else connects to it. The default is reachable from this machine only.
    lease_s: a process silent for this long counts as gone, s.
    timeout_s: how long to wait for the learner, s.
    user, password: what this process calls itself. users_file: the learner's list, one `user:password` a
        line; whoever is not in it is refused.
    tls_ca: certificate (PEM) that clients check the learner against. tls_certificate, tls_key: the learner's.
    """

    endpoint: str = "tcp/127.0.0.1:7447"
    lease_s: float = 3.0
    timeout_s: float = 10.0
    user: str = ""
    password: str = field(default="", repr=False)
    users_file: str = ""
    tls_ca: str = ""
    tls_certificate: str = ""
    tls_key: str = ""

    def __post_init__(self) -> None:
        match = _ENDPOINT.fullmatch(self.endpoint)
        if match is None or not 0 < int(match[3]) < 65536:
            raise UserError(f"wire.endpoint: got {self.endpoint!r}; expected tcp/HOST:PORT or tls/HOST:PORT")
        for name, low, high in (("lease_s", 0.5, 60.0), ("timeout_s", 0.1, 3600.0)):
            value = getattr(self, name)
            if not low <= value <= high:
                raise UserError(f"wire.{name}: got {value!r} s; allowed {low:g}..{high:g} s")
        if bool(self.user) != bool(self.password):
            raise UserError("wire.user, wire.password: give both or neither")
        for name in ("users_file", "tls_ca", "tls_certificate", "tls_key"):
            path = getattr(self, name)
            if path and not Path(path).is_file():
                raise UserError(f"wire.{name}: no file at {path}")
        if match[1] == "tls" and not (self.tls_ca or self.tls_certificate):
            raise UserError("wire.tls_ca: a tls endpoint needs it (on the learner: tls_certificate and tls_key)")
        if bool(self.tls_certificate) != bool(self.tls_key):
            raise UserError("wire.tls_certificate, wire.tls_key: give both or neither")

    @property
    def is_loopback(self) -> bool:
        return self.endpoint.split("/", 1)[1].startswith(_LOOPBACK)

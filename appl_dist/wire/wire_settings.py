"""Where the wire is and who may use it, checked before any socket is opened."""

from __future__ import annotations

import re
from dataclasses import dataclass

from appl_dist.errors import UserError

_ENDPOINT = re.compile(r"(tcp|tls)/(\[[0-9A-Fa-f:]+\]|[A-Za-z0-9_.-]+):(\d{1,5})")
_LOOPBACK = ("127.", "localhost", "[::1]")
MAX_ACTORS = 4000  # of one learner
MAX_CONNECTIONS = MAX_ACTORS + 96  # that a learner accepts: its actors, views and checks
SECURITY = ("auto", "none", "password", "tls")


@dataclass(frozen=True)
class WireSettings:
    """Settings of one process's connection; UserError naming the field that cannot be. Holds no secret.

    endpoint: `tcp/HOST:PORT` or `tls/HOST:PORT`. The learner listens on it (0.0.0.0 for every interface),
        everyone else connects to it. The default is reachable from this machine only.
    lease_s: a process silent for this long counts as gone, s.
    timeout_s: how long to wait for the learner, s.
    security: "none"; "password" (each identity proves a password, data is not encrypted); "tls" (encrypted, both
        sides prove a certificate of the run's authority); "auto": none on loopback, else passwords in the run's own
        folder, which its learner makes and whoever is given that folder uses. With `keys` it is what the endpoint asks.
    keys: folder made by `appl-dist keys`, see `credentials`. identity: which of its folders is this process's;
        "" takes the one of the process's role or actor id.
    """

    endpoint: str = "tcp/127.0.0.1:7447"
    lease_s: float = 3.0
    timeout_s: float = 10.0
    security: str = "auto"
    keys: str = ""
    identity: str = ""

    def __post_init__(self) -> None:
        match = _ENDPOINT.fullmatch(self.endpoint)
        if match is None or not 0 < int(match[3]) < 65536:
            raise UserError(f"wire.endpoint: got {self.endpoint!r}; expected tcp/HOST:PORT or tls/HOST:PORT")
        for name, low, high in (("lease_s", 0.5, 60.0), ("timeout_s", 0.1, 3600.0)):
            value = getattr(self, name)
            if not low <= value <= high:
                raise UserError(f"wire.{name}: got {value!r} s; allowed {low:g}..{high:g} s")
        if self.security not in SECURITY:
            raise UserError(f"wire.security: got {self.security!r}; allowed {', '.join(SECURITY)}")
        if self.security == "auto" and self.keys:
            object.__setattr__(self, "security", "tls" if match[1] == "tls" else "password")
        if (self.security == "tls") != (match[1] == "tls"):
            raise UserError(
                f"wire.endpoint: got {self.endpoint} with wire.security={self.security}; "
                "tls/HOST:PORT goes with security=tls, tcp/HOST:PORT with none and password"
            )
        if self.is_open == bool(self.keys):
            raise UserError(
                f"wire.keys: got {self.keys!r} with wire.security={self.security}; give the folder that "
                "`appl-dist keys` made with security=password or tls, and only then"
            )

    @property
    def is_open(self) -> bool:
        """Whether nobody proves who he is (yet: "auto" has found no keys)."""
        return self.security in ("auto", "none")

    @property
    def is_loopback(self) -> bool:
        return self.endpoint.split("/", 1)[1].startswith(_LOOPBACK)

    @property
    def connect_endpoint(self) -> str:
        """What a client on the learner's machine connects to when the learner listens on every interface."""
        return self.endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")

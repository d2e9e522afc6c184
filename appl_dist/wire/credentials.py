"""Who may take part in a run: the folders that `appl-dist keys` makes, one for each identity.

    KEYS/ca/          the run's own certificate authority; stays where it was made
    KEYS/learner/     for the learner's machine only; `users` lists every identity and its password
    KEYS/viewer/      may look at a run's status
    KEYS/NAME/        an actor's: may take part as actor NAME, or NAME-anything

An identity's folder holds `ca.pem`, `certificate.pem`, `key.pem` and `password` (one line, NAME:PASSWORD). Hand a
machine only the folder of its own identity. Everything is readable by its owner only.
"""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass
from pathlib import Path

from appl_dist.errors import UserError
from appl_dist.wire.key_expressions import is_name

log = logging.getLogger(__name__)

LEARNER, VIEWER, ACTOR = "learner", "viewer", "actor"
AUTHORITY = "ca"
CA_FILE, CERTIFICATE_FILE, KEY_FILE, PASSWORD_FILE, USERS_FILE = (
    "ca.pem", "certificate.pem", "key.pem", "password", "users",
)  # fmt: skip
_SECRET = (KEY_FILE, PASSWORD_FILE, USERS_FILE)


@dataclass(frozen=True)
class Identity:
    """One folder of credentials. Files are read when a connection is opened, and nowhere kept."""

    folder: Path

    @property
    def name(self) -> str:
        return self.folder.name

    def path(self, file: str) -> str:
        """Absolute path of one of its files; UserError if it is not there, or not for this user to read."""
        path = self.folder / file
        if os.access(self.folder, os.X_OK) and not path.is_file():
            raise UserError(f"wire.keys: no file at {path}; `appl-dist keys {self.folder.parent}` makes it")
        if not os.access(path, os.R_OK):
            raise UserError(f"wire.keys: user {os.geteuid()} may not read {path}; chown it to that user")
        if file in _SECRET and path.stat().st_mode & 0o077:
            log.warning("%s can be read by others; chmod 600 it", path)
        return str(path.resolve())

    def covers(self, actor_id: str) -> bool:
        """Whether this identity may take part as `actor_id`."""
        return actor_id == self.name or actor_id.startswith(f"{self.name}-")

    def password(self) -> tuple[str, str]:
        """(user, password)."""
        user, _, password = Path(self.path(PASSWORD_FILE)).read_text("utf-8").strip().partition(":")
        if not (user and password):
            raise UserError(f"wire.keys: {self.folder / PASSWORD_FILE} should hold one line, NAME:PASSWORD")
        return user, password

    def users(self) -> list[str]:
        """Names of all identities of the run; only the learner has the list."""
        lines = Path(self.path(USERS_FILE)).read_text("utf-8").split()
        names = [line.partition(":")[0] for line in lines]
        wrong = [name for name in names if not is_name(name)]
        if wrong:
            raise UserError(f"wire.keys: {self.folder / USERS_FILE} lists {wrong[0]!r}, which is no name")
        return names


def find(keys: str, wanted: str) -> Identity:
    """The identity in `keys` that covers `wanted`: its own, or of a name it begins with (actor-3: actor-3, then actor).

    "" takes the only identity that is neither learner's nor viewer's, and so does a viewer that has none of its own.
    UserError: none, or several for "".
    """
    root = Path(keys)
    if not root.is_dir():
        raise UserError(f"wire.keys: no folder at {keys}; `appl-dist keys {keys}` makes one")
    if wanted == VIEWER and not (root / VIEWER).is_dir():
        wanted = ""  # on an actor's machine the actor looks
    if wanted:
        name = wanted
        while name:
            if (root / name).is_dir():
                return Identity(root / name)
            name = name.rpartition("-")[0]
        raise UserError(
            f"wire.keys: {keys} holds no credentials for {wanted}; it has {', '.join(_names(root)) or 'none'}"
        )
    others = [name for name in _names(root) if name not in (LEARNER, VIEWER)]
    if len(others) != 1:
        raise UserError(f"wire.identity: {keys} holds {', '.join(others) or 'none'} for actors; say which")
    return Identity(root / others[0])


def _names(root: Path) -> list[str]:
    return sorted(p.name for p in root.iterdir() if p.is_dir() and p.name != AUTHORITY)

"""Files written whole or not at all, and locks on them. Leaf: the standard library and errors only."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import secrets
from pathlib import Path

from appl_dist.errors import UserError

_ADVICE = {
    errno.ENOSPC: "free some space or choose another folder",
    errno.EDQUOT: "free some of your quota or choose another folder",
    errno.EACCES: "choose a folder that you may use",
    errno.EPERM: "choose a folder that you may use",
    errno.EROFS: "choose a folder that can be written",
    errno.ENOENT: "check the path",
    errno.EEXIST: "a file has this name; choose another folder",
    errno.ENOTDIR: "part of this path is a file; choose another folder",
    errno.EISDIR: "this is a folder; give a file",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ELOOP: "its links lead in a circle; choose another folder",
    errno.EMFILE: "allow more open files (ulimit -n) or start fewer processes",
    errno.ENFILE: "this machine has too many open files; start fewer processes",
    errno.EIO: "the disk or network behind it fails; choose another folder",
    errno.ESTALE: "the network folder behind it is gone; mount it again",
}


def explain(error: OSError) -> str:
    """What the system said, and what to do about it: "Permission denied; choose a folder that you may use"."""
    return f"{error.strerror or error}; {_ADVICE.get(error.errno or 0, 'choose another folder')}"


def write_atomic(path: Path, data: str | bytes, sync: bool = False) -> None:
    """Replace `path` by `data`, making its folder; a reader sees the old file or the new one, never half of one.

    sync: return when it is on the disk, so that it survives a power cut. UserError if it cannot be written; then
    nothing has changed.
    """
    partial = path.with_name(f"{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(data.encode() if isinstance(data, str) else data)
        if sync:
            to_disk(partial)
        os.replace(partial, path)
        if sync:
            to_disk(path.parent)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink()
        raise UserError(f"{path}: cannot be written: {explain(error)}") from None


def write_new(path: Path, data: str) -> bool:
    """Make `path` with `data`, whole and on the disk; False if it exists, which then stays as it is."""
    partial = path.with_name(f"{path.name}.{secrets.token_hex(4)}.tmp")
    try:
        partial.write_text(data, "utf-8")
        to_disk(partial)
        os.link(partial, path)  # fails where the name is taken, whoever was first
        to_disk(path.parent)
    except FileExistsError:
        return False
    except OSError as error:
        raise UserError(f"{path}: cannot be written: {explain(error)}") from None
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()
    return True


def lock(descriptor: int, path: Path, held: str) -> None:
    """Take the only lock on an open file; the kernel drops it with the process, however that ends.

    UserError with the sentence `held` if another process has it, or that the file system has no locks.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise UserError(held) from None
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL):
            raise
        raise UserError(
            f"{path}: this file system has no locks ({error.strerror}), which keep two processes apart; use a folder "
            "on one that has, such as a local disk, NFS 4, or Lustre mounted with -o flock"
        ) from None


def to_disk(path: Path) -> None:
    """Wait until a file's content, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
